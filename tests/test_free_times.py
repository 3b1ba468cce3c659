"""Via points whose times are found with the motion: known optima, all solvers, what holds at an optimum."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.cli.solution_summary import solution_rows
from mbocp.exceptions import InconsistentStart
from mbocp.formulation import formulate
from mbocp.guesses.from_solution import iterate_from_solution
from mbocp.guesses.make import plain_guess
from mbocp.problem import load_problem, parse_problem, problem_to_toml
from mbocp.terms import path_constraint, running_cost
from mbocp.view.marks import marks_of, marks_of_result
from tests.solution.damage import make_old
from tests.timelines import numbers_of

ROOT = Path(__file__).parents[1]
BEAD = {"name": str(ROOT / "examples" / "optima" / "robots" / "bead.urdf"), "gravity": [0, 0, 0]}
SCHEMES = ["se1", "se2", "midpoint", "euler", "heun", "rk4", "rkf5"]
STEADY = {"effort": 1.0, "velocity": 1.0}  # light links do not spin
ANY_TIME = {"min": 0.1, "max": 50.0, "guess": 5.0}


def bead(duration: Any, via: list[dict[str, Any]], steps: int = 40, **words: Any) -> mbocp.Problem:
    """A mass of 1 kg in a plane without gravity, from rest to rest by 3 m along x."""
    words = {"goal": {"q": [3.0, 0.0], "v": 0}, "scheme": "midpoint", "cost": {"effort": 1.0}, **words}
    return mbocp.Problem.create(BEAD, duration, steps, via=via, **{"integrator": {"scheme": "se1"}, **words})


def pendulum(duration: Any, via: list[dict[str, Any]], steps: int = 24, **words: Any) -> mbocp.Problem:
    words = {"goal": {"q": [1.0, 0.5], "v": 0}, "scheme": "midpoint", "cost": STEADY, **words}
    return mbocp.Problem.create(
        "double_pendulum", duration, steps, via=via, **{"integrator": {"scheme": "se1"}, **words}
    )


def solved(problem: mbocp.Problem, **how: Any) -> mbocp.Solution:
    solution = mbocp.solve(problem, **how)
    assert solution.converged, solution.advice
    assert solution.limit_violation < 1e-6
    return solution


def lengths_by_phase(problem: mbocp.Problem, s: mbocp.Solution) -> list[np.ndarray]:
    return np.split(np.diff(s.t), [phase.last for phase in problem.timeline.phases[:-1]])


@pytest.mark.parametrize("method", ["monolithic", "ipopt"])
def test_minimum_time_with_stops_on_the_way(method: str) -> None:
    """Each way takes 2 sqrt(d/a): drive, brake, with the change of sign at a node in its middle."""
    via = [{"name": "first", "time": "free", "share": 0.5, "q": {"x": 0.5}, "v": {"x": 0.0}}]
    via.append({"name": "second", "time": "free", "share": 0.7, "q": {"x": 2.5}, "v": {"x": 0.0}})
    words = {"cost": {"time": 1.0, "effort": 1e-9}, "limits": {"effort": 1.0}}
    problem = bead(ANY_TIME, via, **words)
    s = solved(problem, solver=method)
    wanted = 2.0 * np.sqrt([0.5, 2.0, 0.5])
    found = np.diff([0.0, *s.via_times.values(), s.duration])
    assert found == pytest.approx(wanted, rel=1e-5)
    for lengths in lengths_by_phase(problem, s):
        assert np.allclose(lengths, lengths[0], rtol=1e-9)


def test_minimum_time_past_a_point_at_speed() -> None:
    """Where the motion has to turn it stops by itself: out and back by d take 4 sqrt(d/a)."""
    via = [{"name": "there", "time": "free", "q": {"x": 2.0}}]
    words = {"cost": {"time": 1.0, "effort": 1e-9}, "limits": {"effort": 1.0}}
    s = solved(bead(ANY_TIME, via, goal={"q": [0.0, 0.0], "v": 0}, **words))
    assert s.duration == pytest.approx(4.0 * np.sqrt(2.0), rel=1e-5)
    assert s.via_times["there"] == pytest.approx(2.0 * np.sqrt(2.0), rel=1e-5)
    # On the straight way a point costs nothing; with the change of sign there, it is at half of the time.
    via = [{"name": "middle", "time": "free", "q": {"x": 1.5}}]
    s = solved(bead(ANY_TIME, via, **words))
    assert s.duration == pytest.approx(2.0 * np.sqrt(3.0), rel=1e-5)
    assert s.via_times["middle"] == pytest.approx(np.sqrt(3.0), rel=1e-4)


@pytest.mark.parametrize(("scheme", "order"), [("se1", 2), ("midpoint", 2), ("heun", 2), ("rk4", 2)])
def test_least_effort_through_a_point_aside(scheme: str, order: int) -> None:
    """By symmetry in the middle of the time, with 6 d^2/T^3 along x and 96 h^2/T^3 along z."""
    T, h = 2.0, 0.7
    wanted = (6.0 * 3.0**2 + 96.0 * h**2) / T**3
    errors = []
    for steps in (20, 40):
        via = [{"name": "aside", "time": "free", "share": 0.3, "q": [1.5, h]}]
        s = solved(bead(T, via, steps, scheme=scheme))
        errors.append((abs(s.cost - wanted), abs(s.via_times["aside"] - T / 2)))
    (cost, when), (finer_cost, finer_when) = errors
    assert finer_cost < 0.02 * wanted
    assert finer_when < 0.02 * T
    assert cost > 1.7 ** (order - (scheme in ("se1", "euler"))) * finer_cost
    assert when > 1.5 * finer_when or when < 1e-6


def test_a_point_on_the_optimum_is_passed_when_the_optimum_passes_it() -> None:
    """The cubic 3 s^2 - 2 s^3 is at 0.2 where s is 0.2871..., whatever the share of the steps."""
    root = min(np.roots([-2.0, 3.0, 0.0, -0.2]), key=lambda r: abs(r - 0.3)).real
    for share in (0.2, 0.5):
        via = [{"name": "on it", "time": "free", "share": share, "q": {"x": 0.6}}]
        s = solved(bead(2.0, via, 200))
        assert s.via_times["on it"] == pytest.approx(2.0 * root, abs=2e-4)
        assert s.cost == pytest.approx(6.0 * 3.0**2 / 2.0**3, rel=1e-4)
        assert s.duration == 2.0


GIVEN = [(scheme, 0.5, STEADY) for scheme in SCHEMES]
FREE = [
    (scheme, {"min": 0.02, "max": 5.0, "guess": 0.3}, {**STEADY, "time": 3.0})
    for scheme in ("se1", "midpoint", "euler")
]


@pytest.mark.parametrize(("scheme", "duration", "cost"), GIVEN + FREE)
def test_solvers_agree(scheme: str, duration: Any, cost: dict[str, float]) -> None:
    via = [{"name": "a", "time": "free", "q": [0.8, 0.1]}]
    steps = 40 if scheme in ("heun", "rk4") else 24  # fewer have other optima beside
    problem = pendulum(duration, via, steps, scheme=scheme, cost=cost)
    own, ipopt = (solved(problem, solver=name) for name in ("monolithic", "ipopt"))
    fatrop = solved(problem.with_(solver={"method": "fatrop", "tolerance": 1e-7}))
    for other, tolerance in ((ipopt, 1e-6), (fatrop, 1e-4)):
        assert other.cost == pytest.approx(own.cost, rel=tolerance)
        assert other.duration == pytest.approx(own.duration, rel=tolerance)
        assert other.via_times["a"] == pytest.approx(own.via_times["a"], rel=10 * tolerance)
    node = problem.timeline.waypoints[0].node
    assert own.qs[node] == pytest.approx([0.8, 0.1], abs=1e-9)
    assert own.t[node] == own.via_times["a"]


@pytest.mark.parametrize("scheme", ["se1", "se2", "midpoint"])
def test_the_hamiltonian_goes_on_through_a_free_time_and_jumps_at_a_given_one(scheme: str) -> None:
    """The derivative of the Lagrangian in a time is the difference of the mean Hamiltonians beside it."""

    def means(duration: Any, time: dict[str, Any], cost: dict[str, float]) -> tuple[float, float]:
        via = [{"name": "a", "q": [0.8, 0.1], **time}]
        problem = pendulum(duration, via, scheme=scheme, cost=cost)
        s, node = solved(problem, solver="monolithic"), problem.timeline.waypoints[0].node
        return s.control_hamiltonians[:node].mean(), s.control_hamiltonians[node:].mean()

    before, after = means(0.5, {"time": "free"}, STEADY)
    assert before == pytest.approx(after, abs=1e-6)
    assert abs(before) > 0.01
    before, after = means(0.5, {"share": 0.5}, STEADY)
    assert abs(before - after) > 0.1 * abs(before)
    both = means({"min": 0.02, "max": 5.0, "guess": 0.3}, {"time": "free"}, {**STEADY, "time": 3.0})
    assert both == pytest.approx([0.0, 0.0], abs=1e-6)


def test_a_free_time_costs_no_more_than_any_given_one() -> None:
    via = [{"name": "a", "time": "free", "q": [0.8, 0.1]}]
    best = solved(pendulum(0.5, via, 100))
    node = round(best.via_times["a"] / 0.5 * 100)
    costs = [
        solved(pendulum(0.5, [{"share": n / 100, "q": [0.8, 0.1]}], 100)).cost
        for n in range(node - 6, node + 7, 3)
    ]
    assert min(costs) == pytest.approx(best.cost, rel=2e-3)
    assert np.argmin(costs) == 2
    assert costs[0] > best.cost < costs[-1]


@pytest.mark.parametrize("duration", [0.5, {"min": 0.02, "max": 5.0, "guess": 0.5}], ids=["given", "free"])
def test_it_is_the_best_of_all_times_that_could_be_given(duration: Any) -> None:
    """With the same steps costs are a parabola about it: the derivative in the time vanishes."""
    cost = STEADY if duration == 0.5 else {**STEADY, "time": 3.0}
    via = {"name": "a", "q": [0.8, 0.1], "share": 0.5}

    def cost_at(time: Any) -> mbocp.Solution:
        return solved(pendulum(duration, [{**via, "time": time}], cost=cost))

    best, step = cost_at("free"), 0.01
    found = best.via_times["a"]
    before, there, after = (
        cost_at({"min": time, "max": time}) for time in (found - step, found, found + step)
    )
    assert before.via_times["a"] == pytest.approx(found - step, abs=1e-12)
    assert there.cost == pytest.approx(best.cost, rel=1e-9)
    rise = before.cost + after.cost - 2.0 * there.cost
    assert rise > 1e-5 * best.cost
    assert abs(after.cost - before.cost) < 0.1 * rise


def test_bounds_of_a_time_are_kept_and_named() -> None:
    free = solved(pendulum(0.5, [{"name": "a", "time": "free", "q": [0.8, 0.1]}])).via_times["a"]
    for bounds, side, limit in (
        ({"max": free - 0.05}, "upper", free - 0.05),
        ({"min": free + 0.05}, "lower", free + 0.05),
    ):
        s = solved(pendulum(0.5, [{"name": "a", "time": bounds, "q": [0.8, 0.1]}]))
        assert s.via_times["a"] == pytest.approx(limit, rel=1e-6)
        (touched,) = [a for a in s.active_limits if a.kind == "time"]
        assert (touched.name, touched.side, touched.unit) == ("a", side, "s")
        rows = dict(solution_rows(s, "robot"))
        assert f"time of via a at its {side} bound" in str(rows["limits"])
        assert "a at " in str(rows["via points"])
        assert " to " in str(rows["horizon"])


def test_times_that_are_given_among_free_ones_are_kept() -> None:
    """By a number, or by a share of a given duration, whatever their node; free durations take numbers."""
    via = [
        {"name": "a", "time": "free", "q": {"x": 0.7}},
        {"name": "b", "time": 0.9, "q": [1.5, 0.3]},
        {"name": "c", "share": 0.8, "q": [2.5, 0.1]},
    ]
    s = solved(bead(2.0, via))
    assert s.via_times["b"] == pytest.approx(0.9, abs=1e-9)
    assert s.via_times["c"] == pytest.approx(1.6, abs=1e-9)
    words = {"cost": {"time": 50.0, "effort": 1.0}}
    s = solved(
        bead({"min": 0.5, "max": 9.0, "guess": 2.0}, [{"name": "b", "time": 0.9, "q": [1.5, 0.3]}], **words)
    )
    assert s.via_times["b"] == pytest.approx(0.9, abs=1e-9)
    assert abs(s.duration - 2.0) > 0.1


def test_a_way_of_no_length_takes_the_least_time_and_is_named() -> None:
    via = [{"name": n, "time": "free", "share": x, "q": [1.5, 0.5]} for n, x in (("a", 0.4), ("b", 0.6))]
    s = solved(bead(2.0, via))
    (touched,) = [a for a in s.active_limits if a.kind == "way"]
    assert touched.name == "b"
    assert s.via_times["b"] - s.via_times["a"] == pytest.approx(1e-3 * 0.2 * 2.0, rel=1e-4)
    assert "way to b in the least time" in str(dict(solution_rows(s, "robot"))["limits"])
    words = "the time between via 'a' and 'b' vanishes (0.0004 s), as where their tolerances meet"
    assert words in s.advice
    early = mbocp.solve(bead(2.0, via, steps=20, solver={"max_iterations": 26}))
    assert not early.converged
    assert early.advice.startswith("the time between via 'a' and 'b' vanishes")


@pytest.mark.parametrize("kind", ["line", "hold", "control", "at_rest"])
@pytest.mark.parametrize("scheme", ["se2", "midpoint", "heun"])
def test_guesses_have_the_guessed_times(kind: str, scheme: str) -> None:
    via = [{"name": "a", "time": {"guess": 0.3}, "share": 0.25, "q": [0.8, 0.1]}]
    formulation = formulate(pendulum(0.5, via, scheme=scheme))
    iterate, _ = plain_guess(kind, formulation)
    motion = formulation.motion_of(iterate)
    assert motion.dts[:6].sum() == pytest.approx(0.3)
    assert motion.dts.sum() == pytest.approx(0.5)
    assert motion.us.shape == (24, 2)
    if kind == "line":
        assert motion.qs[6] == pytest.approx([0.8, 0.1], abs=1e-12)
        speeds = np.diff(motion.qs, axis=0) / motion.dts[:, None]
        assert np.abs(speeds[6] - speeds[5]).max() < 0.2 * np.abs(speeds).max()  # no jump at the point


def test_results_keep_them(tmp_path: Path) -> None:
    via = [{"name": "gate", "time": {"min": 0.1}, "frame": {"name": "bead", "x": 0.7, "z": 0.4}}]
    problem = bead(2.0, via)
    s = solved(problem)
    again = mbocp.Solution.load(s.save(tmp_path / "s.h5"))
    assert again == s
    assert again.via_times == s.via_times
    assert np.ptp(np.diff(again.t)) > 1e-3
    (tmp_path / "again.toml").write_text(s.problem_text)
    same = load_problem(tmp_path / "again.toml")
    assert [p.node for p in same.timeline.waypoints] == [p.node for p in problem.timeline.waypoints]
    assert numbers_of(same.timeline) == numbers_of(problem.timeline)
    node = problem.timeline.waypoints[0].node
    there = bead(2.0, [{**via[0], "time": {"guess": s.via_times["gate"]}, "share": node / s.num_steps}])
    for marks in (marks_of(there), marks_of_result(again, problem.robot)):
        assert marks.via[0].share == pytest.approx(s.t[node] / s.t[-1], rel=1e-12)
    table = s.to_csv(tmp_path / "s.csv").read_text().splitlines()
    times = [float(line.split(",")[0]) for line in table[1:]]
    assert times == pytest.approx(s.t.tolist(), rel=1e-12)


def test_results_of_a_free_duration_load(tmp_path: Path) -> None:
    """One as it was written when all steps had one length; and with the format number of older ones."""
    packed = Path(__file__).parent / "data" / "result_of_free_duration.h5.gz"
    path = tmp_path / "result.h5"
    path.write_bytes(gzip.decompress(packed.read_bytes()))
    for is_old in (False, True):
        if is_old:
            make_old(path)
        s = mbocp.Solution.load(path)
        assert (s.converged, s.num_steps, s.duration_range) == (True, 8, (0.02, 5.0))
        assert s.duration == 0.17161158524440084
        assert s.via_times == {"halfway": pytest.approx(s.duration / 2, rel=1e-12)}
        assert s.active_limits == ()
        assert "free between 0.02 and 5 s" in dict(solution_rows(s, "robot"))["horizon"]


def test_any_solution_starts_another() -> None:
    """Of other steps, of given times, of another duration; and one of free times one of given ones."""
    via = {"name": "a", "q": [0.8, 0.1]}
    problem = pendulum(0.5, [{**via, "time": "free"}])
    s = solved(problem)
    again = solved(problem, warm_start=s)
    assert again.via_times["a"] == pytest.approx(s.via_times["a"], rel=1e-7)
    assert again.iterations <= s.iterations
    finer = problem.with_(steps=60, via=[{**via, "time": "free", "share": 0.3}])
    formulation = formulate(finer)
    start = formulation.motion_of(iterate_from_solution(s, formulation))
    assert start.qs[18] == pytest.approx([0.8, 0.1], abs=1e-6)
    assert start.dts[:18].sum() == pytest.approx(s.via_times["a"])
    fine = solved(finer, warm_start=s)
    assert fine.via_times["a"] == pytest.approx(s.via_times["a"], rel=2e-2)
    given = solved(pendulum(0.4, [{**via, "share": 0.5}]), warm_start=s)
    assert np.ptp(np.diff(given.t)) < 1e-12
    assert solved(problem, warm_start=given).cost == pytest.approx(s.cost, rel=1e-8)
    free = pendulum({"min": 0.02, "max": 5.0}, [{**via, "time": "free"}], cost={**STEADY, "time": 3.0})
    assert solved(free, warm_start=s).converged


def test_rates_are_those_between_the_middles_of_steps() -> None:
    """Jerks and rates of controls across the node where the length changes, by differences of the motion."""
    via = [{"name": "a", "time": "free", "share": 0.25, "q": [0.9, 0.4]}]
    limits = {"jerk": 12.0, "effort_rate": 8.0, "acceleration": 30.0}
    goal = {"q": [3.0, 0.0], "v": 0, "a": "free", "u": "free"}
    problem = bead(2.0, via, 24, goal=goal, limits=limits, cost={"effort": 1.0, "control_rate": 0.01})
    problem = problem.with_(start={"u": "free"})
    s = solved(problem)
    middles = (s.t[1:] + s.t[:-1]) / 2.0
    assert np.ptp(np.diff(s.t)) > 0.05
    rates = np.diff(s.us, axis=0) / np.diff(middles)[:, None]
    assert np.abs(rates).max() <= 8.0 + 1e-6
    accelerations = np.diff(s.vs, axis=0) / np.diff(s.t)[:, None]
    jerks = np.diff(accelerations, axis=0) / np.diff(middles)[:, None]
    assert np.abs(jerks).max() <= 12.0 + 1e-6
    assert {a.kind for a in s.active_limits} == {"effort_rate", "jerk"}
    effort = 0.5 * float((s.us**2).sum(axis=1) @ np.diff(s.t))
    changes = 0.5 * 0.01 * float(((rates**2).sum(axis=1) * np.diff(middles)).sum())
    assert s.cost == pytest.approx(effort + changes, rel=1e-9)


def test_terms_that_depend_on_the_time_see_the_one_that_is_found() -> None:
    """The integral of t from 0 to T, by the midpoint rule exact, and what goes against waiting."""

    def clock(k: Any) -> Any:
        return k.t

    via = [{"name": "a", "time": "free", "share": 0.4, "q": [0.9, 0.4]}]
    s = solved(bead({"min": 0.5, "max": 9.0, "guess": 2.0}, via, terms=(running_cost(clock, weight=20.0),)))
    effort = 0.5 * float((s.us**2).sum(axis=1) @ np.diff(s.t))
    assert s.cost == pytest.approx(effort + 10.0 * s.duration**2, rel=1e-9)


def test_targets_belong_to_steps() -> None:
    rows = np.linspace([0.0, 0.0], [3.0, 0.0], 41)[1:].tolist()
    cost = {"effort": 1.0, "tracking": 10.0, "target": {"q": rows}, "tracking_weights": {"q": 1.0}}
    s = solved(bead(2.0, [{"name": "a", "time": "free", "q": [1.5, 0.3]}], cost=cost))
    assert np.ptp(np.diff(s.t)) > 1e-4


PATH = {"name": "slow", "kind": "speed", "frame": "bead", "max": 1.5}


def test_a_path_constraint_between_via_points() -> None:
    via = [{"name": n, "time": "free", "q": {"x": x}} for n, x in (("in", 1.0), ("out", 2.0))]
    path = [{**PATH, "from": "in", "until": "out"}]
    problem = bead(2.0, via, path=path)
    s = solved(problem)
    first, last = (point.node for point in problem.timeline.waypoints)
    speeds = np.linalg.norm(s.vs, axis=1)
    assert speeds[first : last + 1].max() <= 1.5 + 1e-9
    assert speeds.max() > 1.6
    (active,) = [a for a in s.active_limits if a.name == "slow"]
    assert active.total == last - first + 1
    again = parse_problem(problem_to_toml(problem))
    assert again.frame_constraints[0].span == problem.frame_constraints[0].span
    finer = problem.with_(steps=80)
    assert (
        finer.frame_constraints[0].span.nodes(80, 1.0).sum()
        == finer.timeline.waypoints[1].node - finer.timeline.waypoints[0].node + 1
    )

    def speed(k: Any) -> Any:
        return k.v[0]

    own = path_constraint(speed, upper=1.5, since="in", until="out", name="own")
    assert solved(bead(2.0, via, terms=(own,))).cost == pytest.approx(s.cost, rel=1e-6)


def test_a_path_constraint_in_a_part_of_a_free_duration() -> None:
    path = [{**PATH, "from": {"share": 0.25}, "until": {"share": 0.5}}]
    free = {"min": 0.5, "max": 9.0, "guess": 2.0}
    problem = bead(free, [], path=path, cost={"effort": 1.0, "time": 20.0})
    s = solved(problem)
    speeds = np.linalg.norm(s.vs, axis=1)
    assert speeds[10:21].max() <= 1.5 + 1e-9
    assert speeds.max() > 1.6
    assert (
        parse_problem(problem_to_toml(problem)).frame_constraints[0].span == problem.frame_constraints[0].span
    )
    given = bead(2.0, [{"name": "gate", "time": 0.5, "q": {"x": 0.5}}], path=[{**PATH, "from": "gate"}])
    assert given.frame_constraints[0].span.nodes(40, 0.05).argmax() == 9


def test_several_goals_have_free_times_of_their_own() -> None:
    goal = {"v": 0, "any": [{"q": [3.0, 0.0]}, {"q": [2.6, 0.0]}]}
    s = solved(bead(2.0, [{"name": "a", "time": "free", "q": [1.5, 0.3]}], goal=goal))
    assert s.goal_place == 1
    assert s.via_times["a"] != pytest.approx(1.0, abs=1e-3)


def test_a_start_that_fits_one_step_length_alone_is_refused() -> None:
    rod = load_problem(ROOT / "examples" / "paper" / "rigid_pendulum.toml")
    across = np.linalg.svd(rod.robot.constraint_jacobian(rod.q_start))[2][-1]
    via = [{"name": "a", "time": "free", "frame": {"name": rod.robot.frame_names[-1], "x": 4.5}}]
    words: dict[str, Any] = {"start": {"v": 0.1 * across}, "via": via, "solver": {"method": "auto"}}
    with pytest.raises(InconsistentStart, match=r"which horizon.duration or via.time leaves free"):
        formulate(rod.with_(integrator={"scheme": "se2"}, **words))
    assert "t" in formulate(rod.with_(integrator={"scheme": "se1"}, **words)).layout.states


def test_closed_loops_take_them() -> None:
    problem = load_problem(ROOT / "examples" / "loops" / "four_bar.toml", {"horizon.steps": 50})
    plain = solved(problem)
    q = problem.robot.assemble(plain.qs[20])
    s = solved(problem.with_(via=[{"name": "a", "time": "free", "share": 0.5, "q": q.tolist()}]))
    assert s.qs[25] == pytest.approx(q, abs=1e-8)
    assert s.via_times["a"] == pytest.approx(plain.t[20], rel=0.01)  # a point of the optimum costs nothing
    assert s.constraint_violation < 1e-9
    assert s.cost == pytest.approx(plain.cost, rel=1e-2)


@pytest.mark.slow
def test_the_tool_of_an_arm_goes_through_two_poses_in_the_least_time() -> None:
    problem = load_problem(ROOT / "examples" / "arms" / "fastest_through_poses.toml")
    s, ipopt = (solved(problem, solver=name) for name in ("monolithic", "ipopt"))
    assert ipopt.duration == pytest.approx(s.duration, rel=1e-6)
    assert list(ipopt.via_times.values()) == pytest.approx(list(s.via_times.values()), rel=1e-5)
    for point in problem.timeline.waypoints:
        (frame,) = point.via.goal.frames
        placed = problem.robot.frame_placement("tool0", s.qs[point.node])
        assert placed.translation == pytest.approx(frame.target.position, abs=1e-8)
        assert np.trace(frame.target.rotation.T @ placed.rotation) == pytest.approx(3.0, abs=1e-12)
    shares = [
        {"name": p.name, "share": p.node / 60, "frame": words_of(p)} for p in problem.timeline.waypoints
    ]
    assert solved(problem.with_(via=shares)).duration > s.duration + 0.01


def words_of(point: Any) -> dict[str, Any]:
    (frame,) = point.via.goal.frames
    target = frame.target
    return {
        "name": frame.name,
        "position": target.position.tolist(),
        "orientation": target.orientation.tolist(),
    }


def test_a_drone_finds_when_to_pass_its_gates() -> None:
    problem = load_problem(ROOT / "examples" / "free_flyer" / "gates.toml")
    s = solved(problem)
    given = [{"name": p.name, "share": p.node / 120, "frame": p_words(p)} for p in problem.timeline.waypoints]
    assert s.cost < solved(problem.with_(via=given)).cost - 1.0
    assert list(s.via_times) == ["gate 1", "gate 2", "gate 3"]


def p_words(point: Any) -> dict[str, Any]:
    (frame,) = point.via.goal.frames
    return {
        "name": frame.name,
        "position": frame.target.position.tolist(),
        "position_tolerance": frame.position_tolerance.tolist(),
    }
