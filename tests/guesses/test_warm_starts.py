"""Warm starts: a solution begins its own problem at its end, and a later one with the rest of its motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.formulation import formulate
from mbocp.guesses.from_solution import iterate_from_solution
from mbocp.problem import Guess, Problem
from mbocp.programme.iterate import IterateRecord
from mbocp.solution import Solution
from mbocp.solution.later import is_complete
from mbocp.solution.rest import begins_beside, place_of_start
from mbocp.solvers.newton_method.monolithic import GlobalisedNewton
from tests.holds.cases import pendulum as held

FREE = {"min": 0.05, "max": 5.0, "guess": 0.6}


def pendulum(scheme: str = "midpoint", steps: int = 16, duration: Any = 0.6, **words: Any) -> Problem:
    words = {"goal": {"q": [0.9, 0.4], "v": 0}, "cost": {"effort": 0.1, "velocity": 1.0}, **words}
    return Problem.create(
        "double_pendulum", duration, steps, scheme=scheme, start={"q": [0.3, -0.2], "v": [0.1, 0.4]}, **words
    )


PROBLEMS: dict[str, Callable[[], Problem]] = {
    "se1": lambda: pendulum("se1"),
    "rk4 within limits": lambda: pendulum("rk4", limits={"effort": 1.2, "velocity": 1.6}),
    "gauss2": lambda: pendulum("gauss2"),
    "gauss2, stages, limits": lambda: pendulum("gauss2", 64, controls="stages", limits={"effort": 1.2}),
    "gauss2, linear, limits": lambda: pendulum(
        "gauss2", controls="linear", limits={"effort": 1.2, "velocity": 1.6}
    ),
    "lobatto3": lambda: pendulum("lobatto3", limits={"velocity": 1.6}),
    "limits": lambda: pendulum(limits={"effort": 1.2, "velocity": 1.6}),
    "rates": lambda: pendulum("midpoint", 64, limits={"acceleration": 9.0, "effort_rate": 15.0}),
    "free duration": lambda: pendulum(
        duration=FREE, cost={"time": 1.0, "effort": 0.01}, limits={"effort": 3.0, "velocity": 4.0}
    ),
    "free via point": lambda: pendulum(
        duration=FREE,
        cost={"time": 1.0, "effort": 0.1, "velocity": 1.0},
        via=[{"name": "over", "time": "free", "share": 0.5, "q": [0.8, -0.4]}],
    ),
    "tool speed": lambda: pendulum(path=[{"kind": "speed", "frame": "link2", "max": 0.28}]),
    "hold with an impact": held,
    "hold with an impact, limits": lambda: held(limits={"effort": 20.0, "velocity": 6.0}),
    "natural coordinates": lambda: pendulum("se1", coordinates="natural", limits={"effort": 1.2}),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_solution_begins_its_own_problem_at_its_end(name: str, tmp_path: Path) -> None:
    problem = PROBLEMS[name]()
    cold = mbocp.solve(problem, check=True)
    cold.save(tmp_path / "cold.h5")
    for start in (cold, Solution.load(tmp_path / "cold.h5")):
        warm = mbocp.solve(problem, warm_start=start, check=True)
        assert warm.iterations <= 1 < cold.iterations
        assert warm.cost == pytest.approx(cold.cost, rel=1e-9)
        assert warm.advice.startswith("a strict local minimum")


def test_a_file_keeps_the_iterate_and_files_without_one_still_start_a_solve(tmp_path: Path) -> None:
    problem = PROBLEMS["gauss2, linear, limits"]()
    cold = mbocp.solve(problem, check=True)
    saved = [cold.save(tmp_path / "new.h5"), replace(cold, iterate=None).save(tmp_path / "old.h5")]
    new, old = (Solution.load(path) for path in saved)
    assert new == cold
    assert old.iterate is None
    assert saved[0].stat().st_size < 1.5 * saved[1].stat().st_size
    again = mbocp.solve(problem, warm_start=old, check=True)
    assert again.cost == pytest.approx(cold.cost, rel=1e-9)


@pytest.mark.parametrize("change", ["goal", "start", "weights", "limits"])
def test_a_problem_nearby_begins_with_the_iterate(change: str) -> None:
    problem = PROBLEMS["limits"]()
    changes: dict[str, dict[str, Any]] = {
        "goal": {"goal": {"q": [0.91, 0.41], "v": 0}},
        "start": {"start": {"q": [0.31, -0.2], "v": [0.1, 0.4]}},
        "weights": {"cost": {"effort": 0.11, "velocity": 1.0}},
        "limits": {"limits": {"effort": 1.19, "velocity": 1.6}},
    }
    near = problem.with_(**changes[change])
    cold, solution = mbocp.solve(near, check=True), mbocp.solve(problem, check=True)
    warm = mbocp.solve(near, warm_start=solution, check=True)
    assert warm.iterations <= cold.iterations
    assert warm.cost == pytest.approx(cold.cost, rel=1e-8)


def test_what_means_something_else_is_not_restored() -> None:
    """The same sizes, in another scheme, another step length, or damaged: the motion alone is taken."""
    solution = mbocp.solve(pendulum("se1"), check=True)
    assert isinstance(solution.iterate, IterateRecord)
    for other in (pendulum("se2"), pendulum("se1", duration=0.7)):
        kept = iterate_from_solution(solution, formulate(other))
        plain = iterate_from_solution(replace(solution, iterate=None), formulate(other))
        np.testing.assert_array_equal(kept.ms, plain.ms)
    short = replace(solution, iterate=solution.iterate.between(np.arange(3.0, 17.0)))
    assert mbocp.solve(pendulum("se1"), warm_start=short).converged


def later(plan: Solution, problem: Problem, node: int, duration: Any = None) -> Problem:
    """The rest of a plan from a node on, with as many steps as are left."""
    rest = plan.duration - float(plan.t[node])
    free = {**FREE, "min": 0.01, "guess": rest} if problem.duration_range is not None else rest
    state = {"q": plan.qs[node], "v": plan.vs[node]}
    return problem.with_(start=state, duration=duration or free, steps=problem.num_steps - node)


REPLANNED = [name for name in PROBLEMS if name != "free via point" and "impact" not in name]


@pytest.mark.parametrize("name", REPLANNED)
def test_a_plan_is_followed_to_its_end_from_any_node(name: str) -> None:
    problem = PROBLEMS[name]()
    plan, iterations = mbocp.solve(problem, check=True), np.zeros(2, int)
    for node in (4, 8, 11):
        rest = later(plan, problem, node)
        cold, warm = mbocp.solve(rest), mbocp.solve(rest, warm_start=plan)
        assert warm.converged or not cold.converged
        assert warm.cost <= cold.cost * (1.0 + 1e-8)
        iterations += [cold.iterations, warm.iterations]
    assert iterations[1] <= iterations[0]


def replan(plan: Solution, place: float, **words: Any) -> Problem:
    """The rest of a plan within limits of jerk, from its state and acceleration at a place, in steps."""
    n, s = divmod(place, 1.0)
    at = {k: (1.0 - s) * x[int(n)] + s * x[int(n) + 1] for k, x in (("q", plan.qs), ("v", plan.vs))}
    a = (1.0 - s) * plan.acceleration_at(int(n)) + s * plan.acceleration_at(int(n) + 1)
    return plan.problem.with_(start={**at, "a": a}, steps=plan.num_steps - int(n), **words)


@pytest.mark.parametrize("limits", [{"jerk": 100.0}, {"effort_rate": 15.0}])
def test_the_rest_of_a_plan_within_limits_of_rates_is_optimal(limits: dict[str, float]) -> None:
    """Its first jerk counts over half a step, its first control has no rate."""
    plan = mbocp.solve(pendulum(steps=32, limits=limits), check=True)
    for node in (6, 12, 20):
        rest = replan(plan, node, duration=plan.duration - float(plan.t[node]))
        formulation = formulate(replace(rest, limits_within=plan.iterate.limits_within))
        kept = iterate_from_solution(plan, formulation)
        assert GlobalisedNewton().judge(formulation.programme, kept).evaluation.residual < 1e-8
        assert mbocp.solve(rest, warm_start=plan, check=True).iterations <= 8


def test_replans_within_limits_of_jerk_take_half_the_iterations_of_cold_ones() -> None:
    """In least time, from nodes and between them, a little beside the plan; none is in vain."""
    limits = {"profile": "ur5e", "effort": False, "acceleration": 15.0}
    free, rng = {"min": 0.01, "max": 5.0}, np.random.default_rng([1000, 1])
    start = rng.uniform(-2.0, 2.0, 6)
    goal = {"q": start + rng.uniform(-1.5, 1.5, 6), "v": 0}
    words = {"limits": {**limits, "jerk": 148.5}, "cost": {"time": 1.0, "effort": 1e-5}}
    plan = mbocp.solve(Problem.create("ur5", free, 40, start={"q": start}, goal=goal, **words), check=True)
    taken = []
    for place in (5.0, 19.6, 23.5):
        guess = plan.duration * (1.0 - place / 40)
        later = replan(plan, place, duration={**free, "guess": guess}, limits={**limits, "jerk": 150.0})
        q, v = later.q_start + 1e-4 * rng.normal(size=6), later.v_start * rng.uniform(0.999, 1.0, 6)
        beside = later.with_(start={"q": q, "v": v, "a": later.a_start})
        warm, cold = mbocp.solve(beside, warm_start=plan, check=True), mbocp.solve(beside, check=True)
        assert warm.duration == pytest.approx(cold.duration, rel=1e-5)
        taken.append((warm.iterations, cold.iterations))
    (warm_median, cold_median), most = np.median(taken, axis=0), np.max(taken, axis=0)
    assert 2 * warm_median < cold_median
    assert most[0] < cold_median


def test_a_start_within_the_first_step_begins_the_rest_of_a_plan() -> None:
    """A replan after a fraction of a step."""
    plan = mbocp.solve(pendulum(steps=32, limits={"jerk": 100.0}), check=True)
    rest = replan(plan, 0.3, duration=plan.duration * (1.0 - 0.3 / 32))
    assert place_of_start(plan, rest) == pytest.approx(0.3, abs=1e-2)
    assert iterate_from_solution(plan, formulate(rest)).is_rest


def test_a_start_beside_that_of_a_plan_begins_with_its_multipliers() -> None:
    """As a first replan of a motion as it is sent; the start itself, and one elsewhere, do not."""
    problem = pendulum(steps=32, limits={"jerk": 100.0})
    plan = mbocp.solve(problem, check=True)
    assert plan.iterate is not None
    assert plan.iterate.iterate.ms.any()
    size = 0.01 * np.abs(plan.qs - plan.qs[0]).max()
    for part, is_beside in ((0.0, False), (1.0, True), (20.0, False)):
        moved = problem.with_(start={"q": plan.qs[0] + part * size, "v": plan.vs[0]})
        assert begins_beside(plan, moved) == is_beside
        kept = iterate_from_solution(plan, formulate(moved))
        assert kept.is_rest == is_beside
        if is_beside:
            np.testing.assert_allclose(kept.ms, plan.iterate.iterate.ms, rtol=1e-6)


def test_multipliers_between_nodes_are_between_those_of_two_steps() -> None:
    plan = mbocp.solve(pendulum(steps=16, limits={"jerk": 100.0}), check=True)
    assert plan.iterate is not None
    whole, bounds = plan.iterate.iterate, plan.iterate.iterate.bounds
    assert bounds is not None
    assert bounds.path.any()
    part = plan.iterate.between(np.arange(3.25, 16.0)).iterate
    assert part.bounds is not None
    np.testing.assert_allclose(part.ms, 0.75 * whole.ms[3:15] + 0.25 * whole.ms[4:], atol=1e-14)
    np.testing.assert_allclose(
        part.bounds.path, 0.75 * bounds.path[3:15] + 0.25 * bounds.path[4:], atol=1e-14
    )
    np.testing.assert_allclose(part.bounds.xs, 0.75 * bounds.xs[3:16] + 0.25 * bounds.xs[4:], atol=1e-14)
    np.testing.assert_array_equal(plan.iterate.between(np.arange(17.0)).iterate.ms, whole.ms)


def test_a_start_between_nodes_is_found_or_given() -> None:
    problem = pendulum("se1")
    plan = mbocp.solve(problem, check=True)
    q, v = (0.7 * values[5] + 0.3 * values[6] for values in (plan.qs, plan.vs))
    rest = problem.with_(start={"q": q + 1e-4, "v": v}, duration=0.4, steps=16)
    assert place_of_start(plan, rest) == pytest.approx(5.3, abs=1e-2)
    assert place_of_start(plan, problem) == 0.0
    time = 5.3 * problem.dt
    found = iterate_from_solution(plan, formulate(rest))
    given = iterate_from_solution(plan, formulate(rest), at=time)
    np.testing.assert_allclose(given.xs[0], rest.q_start.tolist() + rest.v_start.tolist())
    np.testing.assert_allclose(found.xs[1:], given.xs[1:], atol=1e-2)
    np.testing.assert_allclose(given.xs[-1, :2], plan.qs[-1], atol=1e-12)
    assert mbocp.solve(rest, warm_start=plan, at=time, check=True).iterations <= 3


def test_a_start_beside_the_motion_takes_all_of_it() -> None:
    problem = pendulum("se1")
    plan = mbocp.solve(problem, check=True)
    for start in ({"q": plan.qs[8] + 0.3}, {"q": plan.qs[8], "v": plan.vs[8] + 1.0}, {"q": plan.qs[-1]}):
        assert place_of_start(plan, problem.with_(start=start)) == 0.0


@pytest.mark.parametrize("at", [-0.1, 0.6, float("nan")])
def test_a_time_beside_the_motion_is_refused(at: float) -> None:
    problem = pendulum("se1")
    plan = mbocp.solve(problem)
    with pytest.raises(InvalidValue, match=r"a time from 0 s, before 0\.6 s"):
        mbocp.solve(problem, warm_start=plan, at=at)
    with pytest.raises(InvalidValue, match="without a warm start"):
        mbocp.solve(problem, at=0.1)


def test_a_file_says_the_time(tmp_path: Path) -> None:
    problem = pendulum("se1")
    plan = mbocp.solve(problem, check=True)
    path = plan.save(tmp_path / "plan.h5")
    rest = later(plan, problem, 6).with_(guess=Guess(kind="solution", path=path, at=float(plan.t[6])))
    assert "at = 0.2" in mbocp.problem.problem_to_toml(rest)
    assert mbocp.solve(rest, check=True).iterations <= 1
    with pytest.raises(ProblemError, match=r"guess\.at"):
        Guess(at=0.1)


def test_a_warm_start_that_leads_nowhere_is_followed_by_the_guess() -> None:
    problem = pendulum("se1", limits={"effort": 1.2})
    cold = mbocp.solve(problem, check=True)
    rng = np.random.default_rng(0)
    wild = replace(
        cold, qs=40.0 * rng.normal(size=cold.qs.shape), vs=1e4 * rng.normal(size=cold.vs.shape), iterate=None
    )
    warm = mbocp.solve(problem, warm_start=wild, check=True)
    assert warm.cost == pytest.approx(cold.cost, rel=1e-9)
    assert "from the warm start" in warm.advice
    assert warm.iterations > cold.iterations
    assert warm.phases[0].name == "from the warm start"


def test_a_plan_that_was_just_found_is_taken_without_working_out_the_rest_of_it() -> None:
    problem = PROBLEMS["limits"]()
    plan = mbocp.solve(problem, check=True)
    assert mbocp.solve(problem, warm_start=plan, check=True).iterations <= 1
    assert not is_complete(plan)
