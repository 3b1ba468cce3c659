"""A screw: what lies on its thread, its derivatives, and the motion of a nut on a spindle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue, ProblemError, RobotFileError
from mbocp.mechanics import JointMechanics, NaturalMechanics
from mbocp.mechanics.held_frames import compute_held_jacobians, compute_held_residuals
from mbocp.mechanics.natural_coordinates.space import NaturalSpace
from mbocp.problem.timeline.hold import Hold
from mbocp.robot import Coupling, Robot, Screw, load_robot
from tests.mechanics.models import chain
from tests.mechanics.models import robot as by_hand
from tests.mechanics.test_simulations import stepper
from tests.robot.loops.test_constraints import differences
from tests.robot.urdfs import chain as chain_urdf
from tests.robot.urdfs import write

PITCH = 0.3  # [m] in a turn
AXIS_A, AXIS_B = np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, -1.0])
TURNS = np.linspace(-15.0, 15.0, 31)  # [rad]
GRAVITY = np.array([1.0, -2.0, -9.0])  # [m/s^2]


def nut(pitch: float = PITCH, **axes: Any) -> Robot:
    """A free body whose origin is on a screw of the world."""
    model, frame = chain("FreeFlyer")
    model.gravity.linear = GRAVITY
    return by_hand(model, constraints=(Screw("thread", frame, 0, pitch, **axes),))


def on_thread(turn: float, pitch: float = PITCH) -> Array:
    """Configuration of the nut after a turn about the world's z [rad]."""
    placement = pin.SE3(pin.exp3(np.array([0.0, 0.0, turn])), np.array([0, 0, pitch * turn / (2 * np.pi)]))
    return np.array(pin.SE3ToXYZQUAT(placement))


@pytest.mark.parametrize("pitch", [PITCH, -0.02])
def test_what_is_on_the_thread_has_no_residual(pitch: float) -> None:
    robot = nut(pitch)
    for turn in TURNS:
        np.testing.assert_allclose(robot.closure_residual(on_thread(turn, pitch)), 0.0, atol=1e-14)
        J = robot.closure_jacobian(on_thread(turn, pitch))
        np.testing.assert_allclose(J @ [0, 0, pitch / (2 * np.pi), 0, 0, 1], 0.0, atol=1e-14)
        assert np.linalg.matrix_rank(J) == 5
    assert [str(label) for label in robot.closure_labels] == [
        "thread.1 [m]",
        "thread.2 [m]",
        "thread.tilt_1 [rad]",
        "thread.tilt_2 [rad]",
        "thread.thread [m]",
    ]


@pytest.mark.parametrize("along", [1.0, -1.0])
def test_axes_stand_askew_in_both_frames_and_may_be_opposed(along: float) -> None:
    """From a place on the thread, the frame turns on about the axis and slides on along it."""
    robot = nut(axis_a=tuple(AXIS_A), axis_b=tuple(along * AXIS_B))
    n_a, n_b = AXIS_A / np.linalg.norm(AXIS_A), AXIS_B / np.linalg.norm(AXIS_B)
    first = pin.SE3(pin.Quaternion.FromTwoVectors(n_a, n_b).matrix(), 0.4 * n_b)
    q = robot.assemble(np.array(pin.SE3ToXYZQUAT(first)))
    placed = pin.XYZQUATToSE3(q)
    for turn in TURNS:
        turned = pin.SE3(pin.exp3(turn * n_b), PITCH * turn / (2 * np.pi) * n_b) * placed
        np.testing.assert_allclose(robot.closure_residual(pin.SE3ToXYZQUAT(turned)), 0.0, atol=1e-13)


def test_derivatives_against_differences() -> None:
    robot = nut(axis_a=tuple(AXIS_A), axis_b=tuple(AXIS_A))
    rng = np.random.default_rng(0)
    for turn in (0.0, 2.0, 7.0):
        q = robot.integrate(on_thread(turn), 0.1 * rng.standard_normal(6))
        np.testing.assert_allclose(robot.closure_jacobian(q), differences(robot, q), rtol=0, atol=1e-8)


def test_force_and_torque_do_the_work_of_the_thread() -> None:
    """The tilts exert torques that are left out."""
    robot = nut()
    lam, q = np.array([0.3, -0.7, 0.0, 0.0, 1.1]), on_thread(2.5)
    force, torque = np.split(robot.constraints[0].wrench_map @ lam, 2)
    in_body = pin.XYZQUATToSE3(q).rotation.T
    generalised = np.concatenate([in_body @ force, in_body @ torque])
    np.testing.assert_allclose(generalised, -robot.constraint_jacobian(q).T @ lam, rtol=0, atol=1e-13)


def spindle() -> Robot:
    """The same nut on a slider and a hinge that a coupling joins."""
    model, _ = chain("PZ RZ")
    model.gravity.linear = GRAVITY
    return by_hand(model, constraints=(Coupling("thread", 1, 2, PITCH / (2 * np.pi)),))


def moving(turn: float, speed: float) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """State of the nut, and of the slider and hinge."""
    slide = PITCH / (2 * np.pi)
    free = on_thread(turn), speed * np.array([0, 0, slide, 0, 0, 1.0])
    return free, (turn * np.array([slide, 1.0]), speed * np.array([slide, 1.0]))


EFFORT = np.array([0, 0, 2.0, 0, 0, -1.5])  # [N, N m] in the body's axes


def test_the_nut_moves_as_on_a_slider_and_a_hinge_that_are_coupled() -> None:
    """To round-off, by SE1 over more than a turn."""
    screwed, coupled = nut(), spindle()
    on_screw, on_joints = stepper(JointMechanics(screwed)), stepper(JointMechanics(coupled))
    free, joint = moving(0.4, 8.0)
    for _ in range(60):
        free, joint = on_screw(*free, EFFORT, 1 / 60), on_joints(*joint, EFFORT[[2, 5]], 1 / 60)
    np.testing.assert_allclose(screwed.difference(free[0], on_thread(joint[0][1])), 0, atol=1e-10)
    np.testing.assert_allclose(free[1][[2, 5]], joint[1], rtol=0, atol=1e-10)
    assert joint[0][1] > 0.4 + 2.0 * np.pi


def test_the_nut_moves_alike_in_natural_coordinates() -> None:
    """Up to an error that goes like the step, past the half turn where the angle begins anew."""
    robot, (free, _) = nut(), moving(2.8, 4.0)
    bodies = NaturalMechanics(robot)
    space = NaturalSpace(bodies, free[0])
    in_joints, in_bodies, gaps = stepper(JointMechanics(robot)), stepper(bodies), []
    z = ca.SX.sym("z", bodies.nq)
    rows = ca.Function("Phi", [z], [bodies.constraints(z)])
    for steps in (20, 40):
        joint = free
        body = space.coordinates(free[0][None])[0], space.rates(free[0][None], free[1][None])[0]
        for _ in range(steps):
            joint, body = in_joints(*joint, EFFORT, 0.2 / steps), in_bodies(*body, EFFORT, 0.2 / steps)
        assert np.abs(np.asarray(rows(body[0]))).max() < 1e-12
        end = space.configurations(body[0][None])[0]
        gaps.append(float(np.abs(robot.difference(joint[0], end)).max()))
        assert robot.difference(free[0], joint[0])[5] + 2.8 > np.pi + 0.2
    assert 1.8 < gaps[0] / gaps[1] < 2.2, gaps


def test_a_hold_keeps_a_frame_on_the_thread_through_where_it_is() -> None:
    model, _ = chain("FreeFlyer")
    robot, rng = by_hand(model), np.random.default_rng(3)
    anchor = robot.integrate(robot.q0, rng.standard_normal(6))
    axis = AXIS_A / np.linalg.norm(AXIS_A)
    held = (Hold(name="nut", frame="body", kind="screw", axis=tuple(axis), pitch=PITCH).as_frame(robot),)
    twist = np.concatenate([PITCH / (2 * np.pi) * axis, axis])
    for turn in TURNS:
        q = np.array(pin.SE3ToXYZQUAT(pin.XYZQUATToSE3(anchor) * pin.exp6(turn * twist)))
        np.testing.assert_allclose(
            compute_held_residuals(robot, held, q[None], anchor[None]), 0.0, atol=1e-13
        )
    J = compute_held_jacobians(robot, held, anchor[None])[0]
    np.testing.assert_allclose(J @ twist, 0.0, atol=1e-14)
    assert np.linalg.matrix_rank(J) == 5


def test_a_robot_toml_has_screws(tmp_path: Path) -> None:
    toml = '[[constraint]]\ntype = "screw"\nframes = ["l1", "world"]\n{}\n'
    urdf = chain_urdf("floating")
    robot = load_robot(write(tmp_path / "good", urdf, toml.format("pitch = 0.01\naxis = [0, 0, 2]")))
    assert robot.constraints == (
        Screw("screw_0", robot.frame_id("l1"), 0, 0.01, ("l1", "world"), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)),
    )
    assert np.abs(robot.constraint_residual(robot.q0)).max() < 1e-10
    with pytest.raises(RobotFileError, match=r"constraint\[0\]\.pitch: this key is required"):
        load_robot(write(tmp_path / "none", urdf, toml.format("")))
    with pytest.raises(RobotFileError, match=r"constraint\[0\]\.pitch: .*must not be zero"):
        load_robot(write(tmp_path / "zero", urdf, toml.format("pitch = 0")))
    with pytest.raises(InvalidValue, match="screw 's': pitch: got 0"):
        Screw("s", 1, 0, 0.0)


def test_a_hold_says_its_pitch_where_there_is_a_thread() -> None:
    with pytest.raises(ProblemError, match="hold 'nut': pitch: one of kind 'screw' needs one"):
        Hold(name="nut", frame="body", kind="screw")
    with pytest.raises(ProblemError, match="hold 'nut': pitch: one of kind 'hinge' has none; leave it out"):
        Hold(name="nut", frame="body", kind="hinge", pitch=0.1)
