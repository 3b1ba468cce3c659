"""Feedback gains: the derivative of the optimum's controls in its start, and where there are none."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.solution import Solution

STEP = 1e-4


def pendulum(scheme: str, enforce: str = "penalty", **others: object) -> mbocp.Problem:
    return mbocp.Problem.create(
        mbocp.load_robot("double_pendulum"),
        0.6,
        12,
        start={"q": [0.3, -0.2], "v": [0.1, 0.4]},
        goal={"q": [0.5, 0.1], "v": 0, "enforce": enforce},
        cost={"effort": 0.1, "velocity": 1.0, "terminal": 30.0},
        scheme=scheme,
        **others,
    )


def drone(scheme: str, enforce: str = "penalty") -> mbocp.Problem:
    return mbocp.Problem.create(
        mbocp.load_robot("hector", actuated=["root_joint"]),
        0.5,
        8,
        start={"q": [0.1, 0, 0.2, 0.1, -0.2, 0.1, 0.94**0.5], "v": [0.3, 0, 0, 0.1, 0.5, 0]},
        goal={"q": [0.4, 0.2, 0.3, 0, 0, 0, 1], "v": 0, "enforce": enforce},
        cost={"effort": 0.1, "velocity": 1.0, "terminal": 30.0},
        scheme=scheme,
    )


def solved(problem: mbocp.Problem, **others: object) -> Solution:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return mbocp.solve(problem, check=True, **others)  # type: ignore[arg-type]  # words of `solve`


@pytest.mark.parametrize("make", [pendulum, drone])
@pytest.mark.parametrize("scheme", ["se1", "midpoint", "rk4"])
def test_the_first_gain_is_the_derivative_of_the_first_control(make: object, scheme: str) -> None:
    problem: mbocp.Problem = make(scheme)  # type: ignore[operator]
    solution = solved(problem, gains=True)
    robot = problem.robot
    assert solution.gains.shape == (problem.num_steps, robot.nu, 2 * robot.nv)
    agrees_with_differences(problem, solution, 2e-4)


@pytest.mark.parametrize("make", [pendulum, drone])
def test_gains_reach_an_exact_goal(make: object) -> None:
    """The stiffer the penalty that stands for it, the nearer: gains were up to 60 % off."""
    problem: mbocp.Problem = make("midpoint", "both")  # type: ignore[operator]
    agrees_with_differences(problem, solved(problem, gains=True), 1e-4)


@pytest.mark.parametrize("scheme", ["se1", "midpoint"])
def test_gains_of_rotations_within_limits(scheme: str) -> None:
    """Quaternions are unknowns there; the gains are along the tangent all the same."""
    free, bound = drone(scheme), drone(scheme).with_(limits={"velocity": 50.0, "effort": 200.0})
    gains = [solved(problem, gains=True).gains for problem in (free, bound)]
    np.testing.assert_allclose(gains[1], gains[0], rtol=1e-5, atol=1e-6 * np.abs(gains[0]).max())
    fastest = np.abs(solved(free).vs[1:, 0]).max()
    tight = drone(scheme).with_(limits={"velocity": [0.9 * fastest, *[50.0] * 5]})
    solution = solved(tight, gains=True)
    assert solution.active_limits
    agrees_with_differences(tight, solution, 2e-4)


@pytest.mark.parametrize(
    "limits",
    [
        {"effort": [0.45, 1e3]},  # active from the first step on
        {"effort": [1e3, 0.14]},  # in later steps alone
        {"velocity": [0.85, 0.55]},  # of both joints, in nearly all steps
        {"velocity": [0.85, 0.55], "effort": [0.4, 0.3]},
        {"position": [[-3.0, 0.75], [-0.5, 1.0]]},
        {"acceleration": [5.0, 3.0]},
        {"effort_rate": [4.0, 1.0]},
    ],
    ids=str,
)
def test_gains_keep_active_limits(limits: dict[str, object]) -> None:
    problem = reach(limits)
    solution = solved(problem, gains=True)
    assert solution.active_limits
    # The joint before the last node is at its limit nearly without a force: the barrier still yields there.
    agrees_with_differences(problem, solution, 3e-4 if "position" in limits else 1e-5)


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8])
def test_gains_do_not_decide_which_limits_are_active_where_the_tolerance_does_not(tolerance: float) -> None:
    """Costs are so small that forces of limits are near those of the barrier: gains were up to 9 % off."""
    problem = mbocp.Problem.create(
        mbocp.load_robot("double_pendulum"),
        0.8,
        20,
        start={"q": [0.3, -0.2]},
        goal={"q": [0.9, -0.6], "v": 0},
        cost={"effort": 1e-5},
        limits={"velocity": [1.2, 0.9], "effort": 2.0},
        scheme="midpoint",
        solver={"tolerance": tolerance},
    )
    agrees_with_differences(problem, solved(problem, gains=True), 5e-3)


def reach(limits: dict[str, object]) -> mbocp.Problem:
    return mbocp.Problem.create(
        mbocp.load_robot("double_pendulum"),
        0.6,
        12,
        start={"q": [0.3, -0.2], "v": [0.1, 0.4]},
        goal={"q": [0.9, -0.6], "v": 0, "enforce": "penalty"},
        cost={"effort": 0.1, "velocity": 1.0, "terminal": 300.0},
        scheme="se1",
        limits=limits,
    )


def agrees_with_differences(problem: mbocp.Problem, solution: Solution, tolerance: float) -> None:
    """Of the first control between optima whose starts are a little before and behind."""
    robot, found = problem.robot, solution.gains[0]
    for i in range(2 * robot.nv):
        firsts = []
        for sign in (1.0, -1.0):
            away = np.zeros(2 * robot.nv)
            away[i] = sign * STEP
            q = robot.integrate(problem.q_start, away[: robot.nv])
            moved = problem.with_(q_start=q, v_start=problem.v_start + away[robot.nv :])
            firsts.append(solved(moved, warm_start=solution).us[0])
        slope = (firsts[0] - firsts[1]) / (2.0 * STEP)
        np.testing.assert_allclose(
            found[:, i], slope, rtol=tolerance, atol=0.1 * tolerance * np.abs(found).max()
        )


def test_controls_at_their_limits_do_not_answer() -> None:
    free = solved(pendulum("se1"))
    bound = 0.6 * np.abs(free.us[:, 0]).max()
    solution = solved(pendulum("se1", limits={"effort": [bound, 1e3]}), gains=True)
    at_limit = np.abs(np.abs(solution.us[:, 0]) - bound) < 1e-5
    assert at_limit.any()
    assert not at_limit.all()
    assert not solution.gains[at_limit, 0].any()
    assert solution.gains[~at_limit, 0].any(axis=1).all()
    assert solution.gains[:, 1].any(axis=1).all()


def test_there_are_none_unless_somebody_asks_or_states_are_q_and_v() -> None:
    assert solved(pendulum("se1")).gains.shape == (0, 0, 0)
    natural = mbocp.Problem.create(
        mbocp.load_robot("double_pendulum"),
        0.5,
        10,
        goal={"q": [0.2, 0.1], "v": 0},
        coordinates="natural",
        scheme="se1",
    )
    assert solved(natural, gains=True).gains.shape == (0, 0, 0)


def test_files_keep_them(tmp_path: Path) -> None:
    solution = solved(pendulum("se1"), gains=True)
    np.testing.assert_array_equal(Solution.load(solution.save(tmp_path / "a.h5")).gains, solution.gains)
