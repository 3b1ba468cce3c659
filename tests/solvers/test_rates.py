"""Limits of accelerations, jerks, rates of controls and powers: kept, priced alike by all solvers, told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.cli.solution_summary import solution_rows
from mbocp.exceptions import MbocpError, ProblemError
from mbocp.mechanics.motion_rates import rates_along
from mbocp.problem import Problem
from mbocp.problem.file.tables import problem_to_toml
from mbocp.view.figures.panels import rate_limit_panels

EXAMPLES = Path(__file__).parents[2] / "examples"
GOAL = {"q": [0.6, 0.3], "v": 0.0}
N = 16
LIMITS = {"acceleration": 8.0, "jerk": 100.0, "effort_rate": 40.0, "power": [[-6.0, 12.0]] * 2}


def pendulum(limits: dict[str, Any], **words: Any) -> Problem:
    words = {"scheme": "se1", "goal": GOAL, "cost": {"effort": 1e3, "velocity": 10.0}, **words}
    return Problem.create(
        "double_pendulum",
        words.pop("duration", 1.0),
        N,
        limits=limits,
        **{"integrator": {"scheme": "se1"}, **words},
    )


def solved(problem: Problem, **how: Any) -> mbocp.Solution:
    """An optimum, whatever so few steps do between nodes."""
    solution = mbocp.solve(problem, **how)
    assert solution.is_stationary, solution.advice
    return solution


def rates_of(s: mbocp.Solution) -> dict[str, np.ndarray]:
    """Of a robot whose controls are the torques of all joints, by hand."""
    dt = np.diff(s.t)[:, None]
    a = (s.vs[1:] - s.vs[:-1]) / dt
    return {
        "acceleration": a,
        "jerk": np.vstack([a[:1], a[1:] - a[:-1]]) / dt,
        "effort_rate": (s.us[1:] - s.us[:-1]) / dt[1:],
        "power": s.us * s.vs[1:],
    }


def unlimited(scheme: str = "se1") -> mbocp.Solution:
    return solved(pendulum({}, scheme=scheme))


@pytest.mark.parametrize(
    ("key", "scheme"),
    [
        ("acceleration", "se1"),
        ("jerk", "midpoint"),
        ("effort_rate", "se2"),
        ("power", "se1"),
        ("jerk", "euler"),
    ],
)
def test_solvers_agree_and_limits_are_kept(scheme: str, key: str) -> None:
    """Each at two thirds of what the motion would do without it."""
    free = rates_of(unlimited(scheme))[key]
    bound = float(np.abs(free).max(axis=0).max() * 2.0 / 3.0)
    problem = pendulum({key: bound}, scheme=scheme)
    own, ipopt = (solved(problem, solver=name) for name in ("monolithic", "ipopt"))
    fatrop = solved(problem.with_(solver={"method": "fatrop", "tolerance": 1e-6}))
    for s, tolerance in ((own, 1e-9), (ipopt, 1e-6), (fatrop, 1e-5)):
        found = rates_of(s)[key]
        assert np.abs(found).max() <= bound * (1.0 + 1e-7)
        assert np.abs(found).max() >= bound * (1.0 - 1e-4)  # it is active
        assert s.cost == pytest.approx(own.cost, rel=tolerance)
        assert s.limit_violation <= 1e-7 * bound
        assert {limit.kind for limit in s.active_limits} == {key}
        scale = 1.0 + np.abs(own.lam_path).max()
        assert np.allclose(s.lam_path, own.lam_path, rtol=0, atol=2e-4 * scale)
        assert np.allclose(s.mus, own.mus, rtol=0, atol=2e-4 * (1.0 + np.abs(own.mus).max()))
    assert own.cost > unlimited(scheme).cost


def test_multipliers_are_what_the_cost_gains_from_a_wider_limit() -> None:
    """d(cost)/d(bound) is minus the sum of the multipliers, upper ones less lower ones."""
    bound, step = 8.0, 1e-3
    costs = [solved(pendulum({"acceleration": bound + d})).cost for d in (step, -step)]
    s = solved(pendulum({"acceleration": bound}))
    assert (costs[0] - costs[1]) / (2 * step) == pytest.approx(-np.abs(s.lam_path).sum(), rel=1e-4)
    rates = rates_of(s)["acceleration"]
    at_bound = np.isclose(np.abs(rates), bound, rtol=1e-5)
    assert np.abs(s.lam_path[~at_bound]).max() < 1e-5 * np.abs(s.lam_path).max()
    assert (s.lam_path[at_bound] * rates[at_bound] > 0).all()


@pytest.mark.parametrize("scheme", ["se1", "euler"])
def test_all_at_once_with_a_free_duration(scheme: str) -> None:
    words = {"duration": {"min": 0.1, "max": 5.0}, "cost": {"time": 1.0, "effort": 0.1}, "scheme": scheme}
    own, ipopt = (solved(pendulum(LIMITS, **words), solver=m) for m in ("monolithic", "ipopt"))
    assert own.duration == pytest.approx(ipopt.duration, rel=1e-5)
    assert own.cost == pytest.approx(ipopt.cost, rel=1e-6)
    rates = rates_of(own)
    for key, bound in LIMITS.items():
        lower, upper = bound[0] if isinstance(bound, list) else (-bound, bound)
        assert rates[key].min() >= lower - 1e-6 * abs(lower), key
        assert rates[key].max() <= upper + 1e-6 * abs(upper), key
    free = solved(pendulum({"acceleration": 8.0}, **words))
    assert free.duration < own.duration


def test_wide_limits_change_nothing() -> None:
    wide = solved(pendulum(dict.fromkeys(LIMITS, 1e5), goal={**GOAL, "a": "free"}))
    assert wide.cost == pytest.approx(unlimited().cost, rel=1e-7)
    assert not wide.active_limits
    assert np.abs(wide.lam_path).max() < 1e-6


def held(problem: Problem, q: np.ndarray) -> np.ndarray:
    """Torques against the weight, by Pinocchio."""
    model = problem.robot.model
    return np.array(pin.computeGeneralizedGravity(model, model.createData(), q))


@pytest.mark.parametrize("words", [{}, {"duration": {"min": 0.2, "max": 3.0}, "cost": {"time": 100.0}}])
@pytest.mark.parametrize("controls", ["constant", "linear"])
def test_torques_begin_and_end_with_those_that_hold_the_robot(controls: str, words: dict[str, Any]) -> None:
    """Before, the first and the last one were free: they leap by more than the limit of a step."""
    scheme = "gauss2" if controls == "linear" else "midpoint"
    integrator = {"integrator": {"scheme": scheme}, "scheme": scheme, "controls": controls}
    words = {"duration": 0.25, "start": {"q": [1.2, -0.4]}, **integrator, **words}
    words["cost"] = {"effort": 1.0, **words.get("cost", {})}
    ends = {"start": {**words["start"], "u": "free"}, "goal": {**GOAL, "u": "free"}}
    limited, free = (pendulum({"effort_rate": 40.0}, **{**words, **own}) for own in ({}, ends))
    s, other = solved(limited), solved(free)
    for solution, keeps in ((s, True), (other, False)):
        before, after = held(limited, solution.qs[0]), held(limited, solution.qs[-1])
        if controls == "linear":
            leaps = np.array([solution.u_values[0, 0] - before, solution.u_values[-1, -1] - after])
            most = 0.05 * 40.0 * np.diff(solution.t)[0]
        else:
            leaps = np.array([solution.us[0] - before, solution.us[-1] - after])
            most = 40.0 * np.diff(solution.t)[0] / 2.0 * (1.0 + 1e-7)
        assert (np.abs(leaps).max(axis=1) <= most).all() == keeps
    assert s.limit_violation < 1e-6
    assert sum(name.endswith("at the end") for name in s.path_names) == limited.robot.nu
    assert not any(name.endswith("at the end") for name in other.path_names)
    ipopt = solved(limited, solver="ipopt")
    assert ipopt.cost == pytest.approx(s.cost, rel=1e-6)


def test_controls_beside_a_motion_are_said_or_free(tmp_path: Path) -> None:
    limits = {"effort_rate": 40.0}
    problem = pendulum(limits, start={"u": [3.0, -1.0]}, goal={**GOAL, "u": {"joint1": 2.0, "joint2": 0.5}})
    assert problem.u_before.tolist() == [3.0, -1.0]
    assert problem.u_after.tolist() == [2.0, 0.5]
    s, most = solved(problem), 40.0 * problem.dt / 2.0 * (1.0 + 1e-7)
    assert np.abs(s.us[0] - [3.0, -1.0]).max() <= most
    assert np.abs(s.us[-1] - [2.0, 0.5]).max() <= most
    for one in (problem, pendulum(limits, start={"u": "free"}, goal={**GOAL, "u": "free"}), pendulum(limits)):
        (tmp_path / "again.toml").write_text(problem_to_toml(one))
        again = mbocp.load_problem(tmp_path / "again.toml")
        assert (again.u_start.rule, again.goal.u.rule) == (one.u_start.rule, one.goal.u.rule)
        np.testing.assert_array_equal(again.u_start.value, one.u_start.value)
    with pytest.raises(MbocpError, match=r"goal\.u: says nothing of joint2; give all controls"):
        pendulum(limits, goal={**GOAL, "u": {"joint1": 2.0}})
    # Nothing is known of controls beside a motion that moves, that ends anywhere, or without such limits.
    assert pendulum(limits, start={"v": [0.1, 0.0]}).u_before is None
    assert pendulum(limits, goal={"q": [0.6, 0.3]}).u_after is None
    assert pendulum(limits, start={"free": "q"}).u_before is None
    assert pendulum({"velocity": 9.0}).u_before is pendulum({"velocity": 9.0}).u_after is None
    low = pendulum({**limits, "effort": 0.3}, start={"q": [1.2, 0.0]})
    assert low.u_before is None  # which cannot hold it


ROBOTS: list[tuple[str, dict[str, Any], tuple[str, ...]]] = [
    ("free_flyer/drone_flip", {"scheme": "se1"}, ("effort_rate", "acceleration")),
    ("loops/four_bar", {"scheme": "se1"}, ("acceleration", "jerk")),
]


@pytest.mark.parametrize(("name", "integrator", "keys"), ROBOTS)
def test_robots_of_all_kinds(name: str, integrator: dict[str, Any], keys: tuple[str, ...]) -> None:
    """Free-flyers and closed loops, a little below what the motion does without limits, and begun there."""
    problem = mbocp.load_problem(EXAMPLES / f"{name}.toml").with_(integrator=integrator)
    robot, free = problem.robot, solved(problem)
    rates = rates_along(robot, free.qs, free.vs, free.us, np.diff(free.t))
    limits = {key: (0.98 * np.abs(rates[key]).max(axis=0) + 1e-3).tolist() for key in keys}
    limited = problem.with_(limits=limits, start={"u": "free"}, goal={"u": "free"})  # as they were
    begun = solved(limited, solver="monolithic", warm_start=free)
    own, ipopt = (solved(limited, solver=method) for method in ("monolithic", "ipopt"))
    assert own.cost == pytest.approx(ipopt.cost, rel=1e-6)
    assert free.cost < begun.cost <= own.cost * (1.0 + 1e-6)  # of two minima the nearer one, or the same
    assert own.cost > free.cost
    assert own.limit_violation < 1e-6
    assert {limit.kind for limit in own.active_limits} <= set(keys)
    found = rates_along(robot, own.qs, own.vs, own.us, np.diff(own.t))
    for key in keys:
        assert (np.abs(found[key]) <= np.array(limits[key]) * (1 + 1e-6)).all()


def test_entries_have_sides_of_their_own() -> None:
    free = rates_of(unlimited())["acceleration"]
    lower, upper = 0.8 * free[:, 0].min(), 2.0 * free[:, 0].max()
    s = solved(pendulum({"acceleration": [[lower, upper], 1e9]}))
    a = rates_of(s)["acceleration"]
    assert a[:, 0].min() == pytest.approx(lower, rel=1e-5)
    assert a[:, 0].max() < upper
    assert [(limit.kind, limit.side) for limit in s.active_limits] == [("acceleration", "lower")]


def test_natural_coordinates_keep_rates_of_controls_and_powers_alone() -> None:
    problem = mbocp.load_problem(EXAMPLES / "loops" / "four_bar.toml")
    free = solved(problem)
    bound = float(np.abs(np.diff(free.us, axis=0) / problem.dt).max() / 2.0)
    words = {"coordinates": "natural", "limits": {"effort_rate": bound}}
    joint = solved(problem.with_(limits=words["limits"]))
    natural = solved(problem.with_(**words))
    found = np.abs(np.diff(natural.us, axis=0) / problem.dt).max()
    assert bound * (1 - 1e-3) <= found <= bound * (1 + 1e-6)
    assert natural.cost == pytest.approx(joint.cost, rel=2e-2)  # another discretisation
    for key in ("acceleration", "jerk"):
        with pytest.raises(ProblemError, match=rf"limits\.{key}: natural coordinates have no joint"):
            problem.with_(coordinates="natural", limits={key: 10.0})


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        (
            {"acceleration": True},
            r"limits\.acceleration: got true, but URDFs have no such limits; give numbers",
        ),
        ({"effort_rate": [[1.0, 2.0], 3.0]}, r"limits\.effort_rate.*got \[1.*a range with zero in it"),
        ({"jerk": -1.0}, r"limits\.jerk: got -1"),
        ({"power": {"elbow": 1.0}}, r"limits\.power: robot 'double_pendulum' has no control 'elbow'"),
    ],
)
def test_what_cannot_be_is_refused(limits: dict[str, Any], message: str) -> None:
    with pytest.raises(MbocpError, match=message):
        pendulum(limits)


def test_drives_have_rates_and_no_accelerations() -> None:
    problem = mbocp.load_problem(EXAMPLES / "so3" / "unicycle_pendulum.toml")
    robot = problem.robot
    driven, drive = robot.v_labels[robot.driven[0]].name, robot.u_labels[-1].name
    with pytest.raises(ProblemError, match=r"is prescribed by a control; limit the rate of the control"):
        problem.with_(limits={"acceleration": {driven: 1.0}}, solver={"method": "auto"})
    with pytest.raises(ProblemError, match=r"prescribes a motion and has no power"):
        problem.with_(limits={"power": {drive: 1.0}}, solver={"method": "auto"})


def test_files_say_the_same_again(tmp_path: Path) -> None:
    s = solved(pendulum(LIMITS))
    (tmp_path / "again.toml").write_text(problem_to_toml(pendulum(LIMITS)))
    again = mbocp.load_problem(tmp_path / "again.toml")
    for letter in ("a", "j", "du", "power"):
        for side in ("lower", "upper"):
            name = f"{letter}_{side}"
            assert np.array_equal(getattr(again.limits, name), getattr(pendulum(LIMITS).limits, name))
    s.save(tmp_path / "result.h5")
    read = mbocp.Solution.load(tmp_path / "result.h5")
    assert read.active_limits == s.active_limits
    assert read.path_names == s.path_names
    assert {limit.kind for limit in read.active_limits} <= set(LIMITS)


def test_summary_and_panels_name_them() -> None:
    problem = pendulum(LIMITS)
    s = solved(problem)
    listed = str(dict(solution_rows(s, problem.robot)))
    active = s.active_limits[0]
    assert f"{active.kind} {active.name} at its {active.side} limit {active.bound:g} {active.unit}" in listed
    assert "steps" in listed
    titles = {panel.title.split(",")[0] for panel in rate_limit_panels(s, problem.robot)}
    assert titles == {"Acceleration", "Jerk", "Rate of the control", "Power"}
    assert {panel.title for panel in rate_limit_panels(s)} >= {"Acceleration", "Jerk"}
    assert not rate_limit_panels(unlimited())
