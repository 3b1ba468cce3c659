"""Rows of holonomic constraints: what they vanish for, and their Jacobians against differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue
from mbocp.robot import (
    Coupling,
    Hinge,
    PointOnLine,
    PointOnPlane,
    PointOnPoint,
    Robot,
    Rod,
    Weld,
)
from mbocp.robot.loops.kinds.constraint import perpendiculars
from tests.mechanics.models import robot as by_hand

KINDS = ("rod", "point", "hinge", "weld", "plane", "line", "coupling")


def tree() -> tuple[Any, int, int]:
    """Two branches with every kind of joint, a body on each, and a frame that stands askew on both."""
    rng, model, ends = np.random.default_rng(0), pin.Model(), []
    for branch in ("FreeFlyer RX RUBZ", "RY PZ Spherical Planar"):
        joint = 0
        for number, kind in enumerate(branch.split()):
            name = f"{kind}_{len(ends)}{number}"
            joint = model.addJoint(joint, getattr(pin, f"JointModel{kind}")(), pin.SE3.Identity(), name)
            body = pin.Inertia(1.0 + rng.random(), rng.random(3), np.diag([1.0, 1.2, 1.4]))
            model.appendBodyToJoint(joint, body, pin.SE3.Identity())
        placement = pin.SE3(pin.exp3(rng.standard_normal(3)), rng.standard_normal(3))
        ends.append(
            model.addFrame(pin.Frame(f"end_{len(ends)}", joint, 0, placement, pin.FrameType.OP_FRAME))
        )
    return model, ends[0], ends[1]


def subject() -> Robot:
    model, a, b = tree()
    hinge, gear = model.getJointId("RX_01"), model.getJointId("RUBZ_02")
    constraints = (
        Rod("rod", a, b, 0.3),
        PointOnPoint("point", a, b),
        PointOnPoint("anchor", a, 0),
        Hinge("hinge", a, b, axis_a=(1, 2, 3), axis_b=(0, 1, -1)),
        Weld("weld", a, b),
        PointOnPlane("plane", a, b, normal=(1, 1, 0)),
        PointOnLine("line", a, b, axis=(1, 0, 2)),
        Coupling("coupling", hinge, model.getJointId("PZ_11"), 0.5, 0.1),
        Coupling("gear", gear, hinge, -2.0, periodic=(True, False)),
    )
    return by_hand(model, constraints=constraints)


SUBJECT = subject()


def differences(robot: Robot, q: Array, step: float = 1e-5) -> Array:
    """Derivative of the residual along the tangent space, by differences of sixth order."""
    columns = []
    for direction in np.eye(robot.nv):
        column = 0.0
        for k, weight in {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}.items():
            ahead, behind = (robot.integrate(q, sign * k * step * direction) for sign in (1, -1))
            column += weight / step * (robot.closure_residual(ahead) - robot.closure_residual(behind))
        columns.append(column)
    return np.array(columns).T


@settings(max_examples=10)
@given(st.integers(0, 10_000))
def test_jacobians_against_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = SUBJECT.integrate(SUBJECT.q0, rng.uniform(-1.5, 1.5, SUBJECT.nv))
    expected = differences(SUBJECT, q)
    np.testing.assert_allclose(SUBJECT.closure_jacobian(q), expected, rtol=0, atol=1e-8)


@settings(max_examples=20)
@given(st.integers(0, 10_000))
def test_a_motion_of_the_whole_changes_nothing(seed: int) -> None:
    """Rows between two frames are invariant when both move with the world's axes."""
    rng = np.random.default_rng(seed)
    model = pin.Model()
    frames = []
    for name in "ab":
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
        frames.append(
            model.addFrame(pin.Frame(f"f{name}", joint, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME))
        )
    a, b = frames
    constraints = (Rod("r", a, b, 1.0), Hinge("h", a, b), Weld("w", a, b), PointOnLine("l", a, b))
    robot = by_hand(model, constraints=constraints)
    poses = [pin.exp6(rng.standard_normal(6)) for _ in "ab"]
    whole = pin.exp6(rng.standard_normal(6))
    here, there = (
        np.concatenate([pin.SE3ToXYZQUAT(moved * pose) for pose in poses])
        for moved in (pin.SE3.Identity(), whole)
    )
    np.testing.assert_allclose(robot.closure_residual(here), robot.closure_residual(there), atol=1e-12)


def two_bodies(constraint: Any) -> Robot:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    model.addFrame(pin.Frame("body", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    return by_hand(model, constraints=(constraint(1, 0),))


def pose(position: tuple[float, float, float], rotation: Array) -> Array:
    return np.array(pin.SE3ToXYZQUAT(pin.SE3(rotation, np.array(position))))


TURN = pin.exp3(np.array([0.0, 0.0, 0.8]))
ALLOWED = {  # what a frame may still do beside the world's
    "point": (lambda a, b: PointOnPoint("c", a, b), pose((0, 0, 0), pin.exp3(np.array([0.3, -0.5, 0.8])))),
    "hinge": (lambda a, b: Hinge("c", a, b), pose((0, 0, 0), TURN)),
    "weld": (lambda a, b: Weld("c", a, b), pose((0, 0, 0), np.eye(3))),
    "plane": (lambda a, b: PointOnPlane("c", a, b), pose((3, -2, 0), TURN)),
    "line": (lambda a, b: PointOnLine("c", a, b), pose((0, 0, -2), TURN)),
    "rod": (lambda a, b: Rod("c", a, b, 5.0), pose((3, 0, -4), TURN)),
}


@pytest.mark.parametrize("kind", ALLOWED)
def test_what_is_allowed_has_no_residual(kind: str) -> None:
    constraint, q = ALLOWED[kind]
    robot = two_bodies(constraint)
    assert robot.constraints[0].kind == kind
    np.testing.assert_allclose(robot.closure_residual(q), 0.0, atol=1e-14)
    assert np.linalg.matrix_rank(robot.closure_jacobian(q), tol=1e-9) == len(robot.constraints[0].rows)


def test_rows_of_a_weld_are_displacement_and_rotation() -> None:
    robot = two_bodies(lambda a, b: Weld("c", a, b))
    small = np.array([1e-5, 2e-5, -3e-5])
    residual = robot.closure_residual(pose((1e-4, -2e-4, 3e-4), pin.exp3(small)))
    np.testing.assert_allclose(residual, [1e-4, -2e-4, 3e-4, *small], atol=1e-9)
    assert [str(label) for label in robot.constraint_labels] == [
        "c.x [m]",
        "c.y [m]",
        "c.z [m]",
        "c.rx [rad]",
        "c.ry [rad]",
        "c.rz [rad]",
    ]


def geared(a: str, b: str, ratio: float, offset: float = 0.0) -> Robot:
    model, names = pin.Model(), (a, b)
    for number, kind in enumerate(names):
        joint = model.addJoint(0, getattr(pin, f"JointModel{kind}")(), pin.SE3.Identity(), f"j{number}")
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    periodic = ("RUB" in a, "RUB" in b)
    coupling = Coupling("gear", 1, 2, ratio, offset, ("j0", "j1"), "rad", periodic)
    return by_hand(model, constraints=(coupling,))


@pytest.mark.parametrize(
    ("a", "b", "ratio"),
    [
        ("RZ", "RX", 0.3),
        ("RUBZ", "RX", 0.3),
        ("RZ", "RUBX", 0.3),
        ("RUBZ", "RUBX", -3.0),
        ("RUBZ", "RUBX", 0.25),
    ],
)
def test_a_gear_turns_many_times(a: str, b: str, ratio: float) -> None:
    robot = geared(a, b, ratio, 0.2)
    for theta in np.linspace(-20.0, 20.0, 41):
        displacements = (ratio * theta + 0.2, theta)
        numbers = [
            [np.cos(x), np.sin(x)] if "RUB" in kind else [x]
            for x, kind in zip(displacements, (a, b), strict=True)
        ]
        assert robot.constraint_residual(np.concatenate(numbers))[0] == pytest.approx(0.0, abs=1e-12)


def test_a_gear_on_continuous_joints_needs_whole_numbers() -> None:
    with pytest.raises(InvalidValue, match=r"coupling 'gear': ratio: got 0\.3.*'j0' and 'j1' are continuous"):
        geared("RUBZ", "RUBX", 0.3)
    with pytest.raises(InvalidValue, match="ratio: got 0"):
        geared("RZ", "RX", 0.0)


def test_perpendiculars_are_a_triad() -> None:
    assert perpendiculars((0.0, 0.0, 1.0)) == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    rng = np.random.default_rng(5)
    for axis in rng.standard_normal((20, 3)):
        n = axis / np.linalg.norm(axis)
        e1, e2 = (np.array(e) for e in perpendiculars(tuple(n)))
        np.testing.assert_allclose(
            np.column_stack([e1, e2, n]).T @ np.column_stack([e1, e2, n]), np.eye(3), atol=1e-15
        )
        assert np.linalg.det(np.column_stack([e1, e2, n])) > 0


def test_axes_must_have_a_direction() -> None:
    with pytest.raises(InvalidValue, match="hinge 'h': axis_a"):
        Hinge("h", 1, 2, axis_a=(0, 0, 0))
    with pytest.raises(InvalidValue, match="line 'l': axis"):
        PointOnLine("l", 1, 2, axis=(0, np.nan, 1))
    assert PointOnPlane("p", 1, 2, normal=(0, 0, -4)).normal == (0.0, 0.0, -1.0)
