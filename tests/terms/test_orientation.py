"""Path constraints on the angle between an axis of a frame and a direction."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.robot import Robot, load_robot

START = [0.0, -1.2, 1.5, -1.87, -1.57, 0.0]  # [rad] the tool points down
GOAL = [1.2, -1.6, 2.0, -1.97, -1.57, 0.5]
WITHIN = 0.2  # [rad]
DOWN: dict[str, Any] = {"kind": "orientation", "frame": "tool0", "direction": [0, 0, -2], "max": WITHIN}


@pytest.fixture(scope="module")
def ur5() -> Robot:
    return load_robot("ur5")


def problem(robot: Robot, *path: dict[str, Any], **others: Any) -> Problem:
    ends = {"start": {"q": START}, "goal": {"q": GOAL, "v": 0}}
    return Problem.create(
        robot,
        1.0,
        20,
        path=path,
        cost={"velocity": 0.1},
        **{"integrator": {"scheme": "se1"}, **ends, **others},
    )


def angles(robot: Robot, qs: Array) -> Array:
    data, frame, found = robot.model.createData(), robot.frame_id("tool0"), []
    for q in qs:
        pin.framesForwardKinematics(robot.model, data, q)
        found.append(np.arccos(-data.oMf[frame].rotation[2, 2]))
    return np.array(found)


def test_values_are_angles(ur5: Robot) -> None:
    given = {
        "kind": "orientation",
        "frame": "tool0",
        "axis": [3, 0, 0],
        "direction": [0, 0.5, 0],
        "min": 1e-3,
    }
    (constraint,) = problem(ur5, given).path
    assert [(label.name, label.unit) for label in constraint.labels] == [("orientation of tool0", "rad")]
    qs = np.array([ur5.integrate(ur5.q0, v) for v in np.random.default_rng(5).standard_normal((4, 6))])
    data = ur5.model.createData()
    for q, value in zip(
        qs, constraint.values_along(ur5, qs, np.zeros((4, 6)), np.zeros((4, 6))), strict=True
    ):
        pin.framesForwardKinematics(ur5.model, data, q)
        assert value == pytest.approx(np.arccos(data.oMf[ur5.frame_id("tool0")].rotation[1, 0]))


@pytest.mark.parametrize(("method", "tolerance"), [("monolithic", 1e-9), ("ipopt", 1e-9), ("fatrop", 1e-6)])
def test_solvers_keep_it(ur5: Robot, method: str, tolerance: float) -> None:
    free = mbocp.solve(problem(ur5), check=True)
    assert angles(ur5, free.qs).max() > 1.5 * WITHIN
    solution = mbocp.solve(problem(ur5, DOWN, solver={"method": method, "tolerance": tolerance}), check=True)
    assert angles(ur5, solution.qs).max() < WITHIN + 1e-6
    assert solution.limit_violation < 1e-6
    (touched,) = solution.active_limits
    assert (touched.name, touched.side, touched.unit) == ("orientation of tool0", "upper", "rad")
    assert touched.bound == WITHIN
    assert solution.cost > free.cost


def test_the_multiplier_is_what_an_angle_costs(ur5: Robot) -> None:
    """The optimal cost falls by the sum of the multipliers for each radian that the bound rises."""
    costs = [mbocp.solve(problem(ur5, {**DOWN, "max": b}), check=True).cost for b in (0.2005, 0.1995)]
    solution = mbocp.solve(problem(ur5, DOWN), check=True)
    assert solution.lam_path.sum() == pytest.approx((costs[1] - costs[0]) / 1e-3, rel=1e-3)


def test_natural_coordinates_and_explicit_schemes_keep_it(ur5: Robot) -> None:
    for others in ({"coordinates": "natural", "solver": "ipopt"}, {"integrator": {"scheme": "euler"}}):
        solution = mbocp.solve(problem(ur5, DOWN, **others), check=True)
        assert angles(ur5, solution.qs).max() < WITHIN + 1e-6


def test_it_reads_back(ur5: Robot) -> None:
    (first,) = problem(ur5, DOWN).path
    (again,) = parse_problem(problem_to_toml(problem(ur5, DOWN))).path
    assert again.name == first.name
    for key in ("axis", "direction"):
        np.testing.assert_array_equal(again.number(key), first.number(key))
    np.testing.assert_array_equal([*again.lower, *again.upper], [-np.inf, WITHIN])


@pytest.mark.parametrize(
    ("changes", "error", "reason"),
    [
        ({"axis": [0, 0, 0]}, InvalidValue, r"axis: got \[0\.0, 0\.0, 0\.0\], expected a direction"),
        ({"max": 4.0}, InvalidValue, "max: got 4.0, expected an angle between 0 and pi"),
        ({"min": 0.5}, InvalidValue, "the lower not above the upper"),
        ({"x": [0, 1]}, ProblemError, 'kind = "orientation" does not use it, but axis, direction, min, max'),
        ({"axis": [1, 0, 0]}, ProblemError, "at the start orientation of tool0 is 1.57"),
    ],
)
def test_what_cannot_be_is_refused(ur5: Robot, changes: dict[str, Any], error: type, reason: str) -> None:
    with pytest.raises(ProblemError, match=reason) as caught:
        problem(ur5, {**DOWN, **changes})
    assert isinstance(caught.value, (error, ProblemError))


def test_a_cup_stays_upright() -> None:
    """The example: without the constraint the cup is tilted by three times as much."""
    file = Path(__file__).parents[2] / "examples" / "arms" / "cup.toml"
    tilts = []
    for changes in ({}, {"path": []}):
        solution = mbocp.solve(mbocp.load_problem(file, changes))
        assert solution.converged, solution.advice
        robot = mbocp.load_problem(file).robot
        axes = [robot.frame_placement("cup", q).rotation[2, 2] for q in solution.qs]
        tilts.append(np.arccos(np.minimum(axes, 1.0)).max())
    assert 0.087 < tilts[0] < 0.0873 + 1e-6
    assert tilts[1] > 3 * tilts[0]
