"""Many problems at once: each is solved as `mbocp.solve` solves it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import DimensionMismatch, InvalidValue, MbocpError, ProblemError
from mbocp.solution import read_solution as reading
from mbocp.solvers import Status

EXAMPLES = Path(__file__).parents[1] / "examples"


def arm(*settings: str) -> mbocp.Problem:
    return mbocp.load_problem(EXAMPLES / "arms" / "ur5_reach.toml", ["horizon.steps=15", *settings])


def agree(motions: mbocp.Motions) -> None:
    """Each motion is the one that `solve` finds."""
    for k in range(len(motions)):
        alone = motions.solution(k)
        assert motions.statuses[k] is alone.status
        assert motions.iterations[k] == alone.iterations
        assert motions.costs[k] == pytest.approx(alone.cost, rel=1e-9)
        for name in ("t", "qs", "vs", "us"):
            np.testing.assert_allclose(getattr(motions, name)[k], getattr(alone, name), rtol=0, atol=1e-9)


@pytest.mark.parametrize("threads", [1, 2])
def test_goals_of_an_arm(threads: int) -> None:
    problem = arm()
    goals = problem.goal.q + np.random.default_rng(0).uniform(-0.4, 0.4, (5, 6))
    motions = mbocp.solve_many(problem, goals=goals, threads=threads)
    assert motions.converged.all()
    assert len(motions) == 5
    np.testing.assert_allclose(motions.qs[:, -1], goals, atol=1e-9)
    agree(motions)


def test_starts_with_velocities_and_weights() -> None:
    rng, problem = np.random.default_rng(1), arm()
    starts = {"q": rng.uniform(-0.5, 0.5, (3, 6)), "v": rng.uniform(-0.2, 0.2, (3, 6))}
    motions = mbocp.solve_many(problem, starts=starts, weights={"effort": [1.0, 3.0, 0.2]})
    assert motions.problem_at(1).cost.weight("effort") == pytest.approx(3.0)
    np.testing.assert_allclose(motions.vs[:, 0], starts["v"], atol=1e-12)
    agree(motions)


def test_it_prints_in_one_line() -> None:
    goals = np.tile(arm().goal.q, (2, 1))
    assert repr(mbocp.solve_many(arm(), goals=goals)) == "<Motions of ur5_reach: 2 of 2 converged>"


def test_one_weight_for_the_velocities_of_all_joints() -> None:
    motions = mbocp.solve_many(arm(), weights={"velocity": [50.0, 200.0]})
    np.testing.assert_array_equal(motions.problem_at(1).cost.velocity, np.full(6, 200.0))
    agree(motions)


@pytest.mark.parametrize("scheme", ["se1", "midpoint", "rk4", "gauss2"])
def test_attitudes_of_a_drone(scheme: str) -> None:
    problem = mbocp.load_problem(
        EXAMPLES / "free_flyer" / "drone_flip.toml", ["horizon.steps=12", f"integrator.scheme={scheme}"]
    )
    moved = [problem.robot.integrate(problem.goal.q, 0.2 * step) for step in np.eye(6)[[0, 3, 5]]]
    motions = mbocp.solve_many(problem, goals=np.array(moved))
    agree(motions)


@pytest.mark.parametrize(
    "cost",
    ['{effort=1.0, velocity="auto"}', "{effort=1.0, velocity=1.0, tracking=1.0}"],
    ids=["auto", "target"],
)
def test_costs_that_go_by_the_goal_are_those_of_each_goal(cost: str) -> None:
    """The weight that mbocp chooses, and the target of a tracking cost that names none."""
    problem = arm(f"cost={cost}")
    goals = problem.goal.q + np.random.default_rng(4).uniform(-0.4, 0.4, (3, 6))
    agree(mbocp.solve_many(problem, goals=goals))
    agree(mbocp.solve_many(problem, goals=np.array([goals[0], goals[1], goals[0]])))


def test_a_cost_that_nobody_says_is_that_of_each_goal() -> None:
    problem = mbocp.Problem.create(
        "ur5", 1.0, 12, goal={"q": [0.5, -1.0, 0.8, 0.1, 0.3, 0.0], "v": [0.0] * 6}
    )
    goals = problem.goal.q + np.random.default_rng(5).uniform(-0.4, 0.4, (3, 6))
    agree(mbocp.solve_many(problem, goals=goals))


@pytest.mark.parametrize(
    "settings",
    [
        ('goal.enforce="penalty"', "cost={effort=1.0, velocity=1.0, terminal=100.0}"),
        ("cost={effort=1.0, velocity=1.0, acceleration=0.1}",),
        ('path=[{frame="tool0", kind="speed", max=3.0}]',),
        ('horizon.controls="stages"',),
        ("limits.acceleration=20.0",),
    ],
    ids=["penalty", "acceleration", "path", "stages", "rates"],
)
@pytest.mark.parametrize("what", ["starts", "goals"])
def test_whatever_else_a_problem_says(settings: tuple[str, ...], what: str) -> None:
    problem = arm(*settings)
    base = problem.goal.q if what == "goals" else problem.q_start
    moved = base + np.random.default_rng(6).uniform(-0.3, 0.3, (2, 6))
    agree(mbocp.solve_many(problem, **{what: np.array([moved[0], moved[1], moved[0]])}))


def test_limits_hold_in_all() -> None:
    problem = arm("limits.velocity=1.6")
    goals = problem.goal.q + np.random.default_rng(2).uniform(-0.3, 0.3, (3, 6))
    motions = mbocp.solve_many(problem, goals=goals)
    assert np.abs(motions.vs[motions.converged]).max() <= 1.6 + 1e-6
    agree(motions)


def test_one_that_has_no_solution_leaves_the_others_alone() -> None:
    problem = arm("limits.velocity=0.9")
    goals = np.array([0.5 * problem.goal.q, problem.goal.q + 6.0])
    with pytest.warns(mbocp.problem.ProblemWarning):
        motions = mbocp.solve_many(problem, goals=goals)
    assert motions.statuses[0] is Status.CONVERGED
    assert motions.statuses[1] is Status.INFEASIBLE
    assert motions.converged.tolist() == [True, False]


def test_what_has_more_to_it_is_solved_one_by_one() -> None:
    """A closed loop, whose end condition depends on where its goal is."""
    problem = mbocp.load_problem(EXAMPLES / "loops" / "four_bar.toml", ["horizon.steps=10"])
    motions = mbocp.solve_many(problem, weights={"effort": [1.0, 2.0]})
    agree(motions)


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({}, ProblemError, "give starts, goals or weights, as many of each; got none"),
        ({"goals": np.zeros(6)}, DimensionMismatch, r"goals.q: got shape \(6,\)"),
        ({"goals": np.zeros((2, 5))}, DimensionMismatch, r"goals.q: got shape \(2, 5\), expected \(any, 6\)"),
        ({"goals": np.full((2, 6), np.nan)}, InvalidValue, "goals.q: got entries that are no numbers"),
        ({"goals": {"x": np.zeros((2, 6))}}, ProblemError, "goals: no 'x'; give some of q, v, p"),
        ({"goals": np.zeros((2, 6)), "starts": np.zeros((3, 6))}, ProblemError, "start.q: 3, goal.q: 2"),
        ({"goals": {"v": [[0.0] * 6, [1e300] * 6]}}, MbocpError, "problem 1: goal.v"),
        ({"starts": [[0.0] * 6, [1e12] * 6]}, MbocpError, "problem 1: start.q"),
        ({"weights": {"effort": [1.0, -1.0]}}, MbocpError, "problem 1: .*effort"),
        ({"goals": np.zeros((2, 6)), "threads": 0}, InvalidValue, "threads"),
        ({"goals": [[0.0] * 6, [0.0] * 5]}, InvalidValue, "goals.q: got something else, expected an array"),
        ({"goals": np.zeros((0, 6))}, DimensionMismatch, r"goals.q: got shape \(0, 6\)"),
    ],
)
def test_what_does_not_fit_is_refused(given: dict[str, Any], error: type, words: str) -> None:
    with pytest.raises(error, match=words):
        mbocp.solve_many(arm(), **given)


def test_a_list_of_problems_is_refused() -> None:
    with pytest.raises(InvalidValue, match="problem: got list, expected one Problem, or the path"):
        mbocp.solve_many([arm()])  # type: ignore[arg-type]


def test_ctrl_c_leaves_what_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, seen = arm(), []
    goals = problem.goal.q + np.random.default_rng(3).uniform(-0.2, 0.2, (6, 6))

    def judge(*arguments: Any) -> Any:
        seen.append(arguments)
        if len(seen) == 3:
            raise KeyboardInterrupt
        return reading.judge(*arguments)

    monkeypatch.setattr("mbocp.many.judge", judge)
    motions = mbocp.solve_many(problem, goals=goals, threads=1)
    assert motions.statuses == (Status.CONVERGED,) * 2 + (Status.INTERRUPTED,) * 4
    assert np.isfinite(motions.qs[:2]).all()
    assert np.isnan(motions.qs[2:]).all()
