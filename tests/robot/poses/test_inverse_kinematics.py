"""Inverse kinematics of forward kinematics: poses that are within reach are reached, within limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbocp._arrays import Array
from mbocp.exceptions import DimensionMismatch, InvalidValue, UnknownFrame
from mbocp.robot import FrameTarget, Robot, load_robot
from mbocp.robot.joints import unit_groups
from tests.mechanics.mimics import tied
from tests.robot import urdfs

ARMS = [("ur5", "tool0"), ("panda", "panda_hand"), ("kinova", "j2s6s200_end_effector"), ("ur10", "tool0")]
FLOATING = [("hector", "base_link"), ("solo12", "FL_FOOT"), ("solo12", "base_link")]
LOOPED = [
    ("five_bar", "right_tip"),
    ("parallelogram_arm", "tool"),
    ("delta", "tool"),
    ("slider_crank", "plunger_tip"),
]


def random_configuration(robot: Robot, seed: int) -> Array:
    """Anywhere within the limits; lengths and angles without limits within some metres and a turn."""
    rng = np.random.default_rng(seed)
    q = np.array(robot.integrate(robot.q0, rng.normal(size=robot.nv)))
    lower, upper = robot.limits.position_lower, robot.limits.position_upper
    closed = np.isfinite(lower) & np.isfinite(upper)
    q[closed] = rng.uniform(lower[closed], upper[closed])
    return np.array(robot.normalise(q))


def assert_within_limits(robot: Robot, q: Array) -> None:
    plain = np.ones(robot.nq, dtype=bool)
    for _, group in unit_groups(robot.model):
        plain[group] = False
    assert (q >= robot.limits.position_lower - 1e-9)[plain].all()
    assert (q <= robot.limits.position_upper + 1e-9)[plain].all()


def assert_same_pose(robot: Robot, frame: str, q: Array, wanted: pin.SE3, relative_to: str = "world") -> None:
    found = robot.frame_placement(frame, q, relative_to)
    assert np.abs(found.translation - wanted.translation).max() < 1e-9
    assert np.linalg.norm(pin.log3(found.rotation.T @ wanted.rotation)) < 2e-9


@pytest.mark.parametrize(("name", "frame"), [*ARMS, *FLOATING])
@settings(max_examples=15)
@given(seed=st.integers(0, 10_000))
def test_poses_within_reach_are_reached(name: str, frame: str, seed: int) -> None:
    robot = load_robot(name)
    wanted = robot.frame_placement(frame, random_configuration(robot, seed))
    found = robot.inverse_kinematics(FrameTarget.at(frame, wanted))
    assert found.reached
    assert_same_pose(robot, frame, found.q, wanted)
    assert_within_limits(robot, found.q)
    assert max(found.position_error, found.angle_error) < 2e-9


@pytest.mark.parametrize(("name", "frame"), LOOPED)
@settings(max_examples=6)
@given(seed=st.integers(0, 10_000))
def test_closed_loops_stay_closed(name: str, frame: str, seed: int) -> None:
    robot = load_robot(name)
    away = 0.1 * np.random.default_rng(seed).normal(size=robot.nv)
    wanted = robot.frame_placement(frame, robot.assemble(robot.integrate(robot.q0, away)))
    found = robot.inverse_kinematics(FrameTarget.at(frame, wanted))
    assert found.reached
    assert_same_pose(robot, frame, found.q, wanted)
    assert np.abs(robot.closure_residual(found.q)).max() < 1e-10


def test_all_eight_branches_of_an_arm() -> None:
    robot = load_robot("ur5")
    target = {"name": "tool0", "position": [0.4, 0.2, 0.3], "rpy": [3.0, 0.1, 0.2]}
    found = robot.inverse_kinematics(target, branches=None)
    assert len(found.branches) == 8
    wanted = robot.frame_placement("tool0", found.q)
    for q in found.branches:
        assert_same_pose(robot, "tool0", q, wanted)
    assert (np.diff(found.distances) >= 0.0).all()
    lengths = [np.linalg.norm(robot.difference(robot.q0, q)) for q in found.branches]
    assert found.distances == pytest.approx(lengths)
    assert pin.rpy.matrixToRpy(wanted.rotation) == pytest.approx([3.0, 0.1, 0.2])


def test_the_same_seed_finds_the_same() -> None:
    robot = load_robot("panda")
    target = {"name": "panda_hand", "position": [0.5, 0.1, 0.4], "axis": [0, 0, 1], "direction": [0, 0, -1]}
    first, second = (robot.inverse_kinematics(target, branches=5, seed=3) for _ in range(2))
    assert len(first.branches) == 5
    assert (first.branches == second.branches).all()


def test_angles_are_those_of_the_turn_nearest_to_the_start() -> None:
    robot = load_robot("ur5")
    start = np.array([5.5, -1.0, 1.0, -5.0, 0.5, 5.0])
    wanted = robot.frame_placement("tool0", start - 2 * np.pi * np.array([1, 0, 0, -1, 0, 1]))
    found = robot.inverse_kinematics(FrameTarget.at("tool0", wanted), start, branches=None)
    assert found.distances[0] == pytest.approx(0.0, abs=1e-8)
    assert all(np.abs(q - start).max() < 2 * np.pi for q in found.branches)


@pytest.mark.parametrize("along", [[0, 0, 2], [0.3, -1, 0.2], [0, 0, -1]])
def test_an_axis_along_a_direction(along: list[float]) -> None:
    robot = load_robot("ur5")
    target = FrameTarget(name="tool0", position=(0.3, None, 0.4), axis=(0, 0, 3), direction=along)
    found = robot.inverse_kinematics(target)
    at = robot.frame_placement("tool0", found.q)
    assert found.reached
    assert at.translation[[0, 2]] == pytest.approx([0.3, 0.4], abs=1e-9)
    assert at.rotation[:, 2] == pytest.approx(np.array(along) / np.linalg.norm(along), abs=2e-9)


def test_an_axis_that_starts_opposite_to_its_direction() -> None:
    robot = load_robot("ur5")
    away = -robot.frame_placement("tool0").rotation[:, 2]
    found = robot.inverse_kinematics({"name": "tool0", "axis": [0, 0, 1], "direction": away})
    assert found.reached
    assert robot.frame_placement("tool0", found.q).rotation[:, 2] == pytest.approx(away, abs=2e-9)


def test_a_pose_relative_to_another_moving_frame() -> None:
    robot, left, right = load_robot("solo12"), "FL_FOOT", "HR_FOOT"
    wanted = robot.frame_placement(left, random_configuration(robot, 3), right)
    found = robot.inverse_kinematics(FrameTarget.at(left, wanted, relative_to=right))
    assert found.reached
    assert_same_pose(robot, left, found.q, wanted, right)


def test_several_frames_together() -> None:
    robot = load_robot("solo12")
    feet = ["FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"]
    q = random_configuration(robot, 5)
    points = [robot.frame_placement(foot, q).translation for foot in feet]
    found = robot.inverse_kinematics([{"name": f, "position": p} for f, p in zip(feet, points, strict=True)])
    assert found.reached
    for foot, point in zip(feet, points, strict=True):
        assert robot.frame_placement(foot, found.q).translation == pytest.approx(point, abs=1e-9)


def test_mimic_joints(tmp_path: Path) -> None:
    hand = tied("hand", tmp_path).robot
    q = hand.integrate(hand.q0, 0.4 * np.ones(hand.nv))
    targets = [{"name": name, "position": hand.frame_placement(name, q).translation} for name in ("t2", "f2")]
    found = hand.inverse_kinematics(targets)
    assert found.reached
    for target in targets:
        reached = hand.frame_placement(target["name"], found.q).translation
        assert reached == pytest.approx(target["position"], abs=1e-9)


def test_out_of_reach_says_how_far(tmp_path: Path) -> None:
    chain = load_robot(urdfs.write(tmp_path, urdfs.chain(*["revolute"] * 3)))
    found = chain.inverse_kinematics({"name": "l3", "position": [9.0, 0.0, 0.0]}, restarts=10)
    assert not found.reached
    assert found.branches.shape == (0, 3)
    at = chain.frame_placement("l3", found.q).translation
    assert found.position_error == pytest.approx(np.linalg.norm(at - [9.0, 0.0, 0.0]))
    assert found.attempts == 11


def test_limits_that_are_in_the_way_are_named() -> None:
    robot = load_robot("panda")
    q = np.array(robot.q0)
    q[:7] = [0.0, 0.3, 0.0, -1.5, 0.0, 1.9, 0.2]
    target = FrameTarget.at("panda_hand", robot.frame_placement("panda_hand", q))
    upper = np.array(robot.limits.position_upper)
    upper[5] = 1.0
    lower = np.array(robot.limits.position_lower)
    lower[[0, 2, 4, 6]], upper[[0, 2, 4, 6]] = -0.3, 0.3
    found = robot.inverse_kinematics(target, within_limits=(lower, upper), restarts=20)
    assert not found.reached
    assert "panda_joint6" in found.at_limits
    assert (found.q >= lower - 1e-12).all()
    assert (found.q <= upper + 1e-12).all()
    assert robot.inverse_kinematics(target).reached


def test_limits_may_be_left_aside() -> None:
    robot = load_robot("panda")
    q = np.array(robot.q0)
    q[:7] = [0.1, 0.2, 0.1, 0.3, 0.0, 1.0, 0.0]  # the elbow beyond its limit
    target = FrameTarget.at("panda_hand", robot.frame_placement("panda_hand", q))
    found = robot.inverse_kinematics(target, q, within_limits=False)
    assert found.reached
    assert found.q == pytest.approx(q, abs=1e-6)
    assert_within_limits(robot, robot.inverse_kinematics(target, q).q)


def test_a_robot_in_another_assembly_mode_is_no_branch() -> None:
    robot = load_robot("five_bar")
    found = robot.inverse_kinematics(
        FrameTarget.at("right_tip", robot.frame_placement("right_tip")), branches=None, restarts=30
    )
    assert len(found.branches) >= 2
    for q in found.branches:
        assert np.abs(robot.closure_residual(q)).max() < 1e-9


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ({"name": "tool0"}, "with neither"),
        ({"name": "tool0", "axis": [0, 0, 1]}, "no direction"),
        ({"name": "tool0", "axis": [0, 0, 0], "direction": [1, 0, 0]}, "a direction, finite and not zero"),
        ({"name": "tool0", "orientation": [0, 0, 0, 0]}, "a unit quaternion"),
        ({"name": "tool0", "position": [np.inf, 0, 0]}, "finite numbers"),
        ({"name": "tool0", "positon": [1, 0, 0]}, "did you mean 'position'"),
        ({"name": "tool0", "position": [1, 0, 0], "x": 1.0}, "one of the two"),
        ({"name": "tool0", "rpy": [1, 0, 0], "orientation": [0, 0, 0, 1]}, "one of the two"),
        ({"name": "tool0", "position": [1, 0, 0], "relative_to": "tool0"}, "another frame"),
        ({"position": [1, 0, 0]}, "the name of a frame"),
        ([], "got none"),
    ],
)
def test_targets_that_cannot_be_right(target: object, message: str) -> None:
    with pytest.raises(InvalidValue, match=message):
        load_robot("ur5").inverse_kinematics(target)


def test_what_does_not_fit_the_robot_is_refused() -> None:
    robot = load_robot("ur5")
    with pytest.raises(UnknownFrame, match="tool0"):
        robot.inverse_kinematics({"name": "tool1", "position": [0.3, 0.3, 0.3]})
    with pytest.raises(DimensionMismatch, match="position"):
        robot.inverse_kinematics({"name": "tool0", "position": [0.3, 0.3]})
    with pytest.raises(InvalidValue, match="branches"):
        robot.inverse_kinematics({"name": "tool0", "position": [0.3, 0.3, 0.3]}, branches=0)
    with pytest.raises(InvalidValue, match="within_limits"):
        robot.inverse_kinematics({"name": "tool0", "x": 0.3}, within_limits=(np.ones(6), np.zeros(6)))
    with pytest.raises(UnknownFrame):
        robot.frame_placement("tool1")
