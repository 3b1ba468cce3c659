"""A pose among obstacles is reached in a configuration that touches nothing."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.problem import Problem
from mbocp.problem.reasons.causes import causes_of

Q_START = np.array([-1.0, -1.2, 1.0, -1.3, -1.57, 0.0])
Q_END = np.array([1.2, -1.0, 1.4, -1.9, -1.57, 0.3])


@pytest.fixture(scope="module")
def arm():
    return mbocp.load_robot("ur5")


def problem(robot, goal, obstacles) -> Problem:
    rest = {"cost": {"effort": 1.0, "velocity": 100.0}, "limits": {"effort": True}}
    return Problem.create(
        robot,
        2.0,
        60,
        start={"q": Q_START},
        goal=goal,
        obstacle=obstacles,
        **{"integrator": {"scheme": "se1"}, **rest},
    )


def pose(robot) -> dict:
    found = robot.frame_placement("tool0", Q_END)
    turn = pin.Quaternion(found.rotation).coeffs()
    return {"v": 0, "frame": {"name": "tool0", "position": found.translation, "orientation": turn}}


def ball_at(robot, q) -> dict:
    """A ball above the elbow."""
    elbow = robot.frame_placement("forearm_link", q).translation
    return {"name": "ball", "shape": "sphere", "radius": 0.03, "position": elbow + np.array([0.0, 0.0, 0.06])}


def test_another_configuration_is_taken_where_the_nearest_touches_something(arm):
    goal = pose(arm)
    free = problem(arm, goal, [])
    found = problem(arm, goal, [ball_at(arm, free.goal.q)])
    assert np.abs(found.goal.q - free.goal.q).max() > 0.1
    assert found.clearance.least(free.goal.q[None])[0] < 0.0 <= found.clearance.least(found.goal.q[None])[0]
    expected, got = (arm.frame_placement("tool0", q) for q in (Q_END, found.goal.q))
    assert expected.isApprox(got, 1e-7)
    solution = mbocp.solve(found)
    assert solution.converged
    assert solution.clearance > 0.0


def test_the_nearest_stays_where_it_touches_nothing(arm):
    goal = pose(arm)
    far = {"name": "ball", "shape": "sphere", "radius": 0.03, "position": [3.0, 0.0, 0.0]}
    np.testing.assert_array_equal(problem(arm, goal, [far]).goal.q, problem(arm, goal, []).goal.q)


def test_a_configuration_that_is_given_is_refused_and_not_changed(arm):
    with pytest.raises(mbocp.MbocpError, match=r"obstacle 'ball': at the goal .* inside it"):
        problem(arm, {"q": Q_END, "v": 0}, [ball_at(arm, Q_END)])


def test_a_pose_with_tolerances_is_clear_within_these_where_its_middle_is_not(arm):
    """A ball about its middle; in a smaller box there is no room beside it."""
    place, ball = np.array([0.4, 0.2, 0.5]), {"shape": "sphere", "radius": 0.05, "position": [0.4, 0.2, 0.5]}
    for size, is_clear in ((0.2, True), (0.02, False)):
        goal = {"frame": {"name": "tool0", "position": place, "position_tolerance": size}}
        found = problem(arm, goal, [ball])
        away = np.abs(arm.frame_placement("tool0", found.goal.q).translation - place)
        assert (found.clearance.least(found.goal.q[None])[0] >= 0.0) == is_clear
        assert (away <= size + 1e-9).all()
        assert [cause.kind for cause in causes_of(found)] == ["goal"] * (not is_clear)
