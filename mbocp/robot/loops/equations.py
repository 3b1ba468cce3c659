"""The equations of holonomic constraints, written once for all coordinates."""

from __future__ import annotations

from typing import Protocol

import casadi as ca
import numpy as np

from mbocp.robot.loops.constraints import (
    Constraint,
    FrameConstraint,
    Hinge,
    PointOnLine,
    PointOnPlane,
    Rod,
    Weld,
    perpendiculars,
)
from mbocp.robot.loops.coupling import Coupling

__all__ = ["Kinematics", "constraint_rows"]


class Kinematics(Protocol):
    """Where frames and joints are, as expressions in a configuration q of any coordinates."""

    def frame_position(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Position of a frame's origin in the world, shape (3,) [m]."""

    def frame_rotation(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Axes of a frame in the world, shape (3, 3)."""

    def joint_displacement(self, joint_id: int, q: ca.SX) -> ca.SX:
        """Angle or length of a joint that has one displacement [rad, m]."""


def constraint_rows(constraint: Constraint, kinematics: Kinematics, q: ca.SX) -> ca.SX:
    """Left-hand sides of a constraint's equations, shape (len(constraint.rows),).

    Parameters
    ----------
    constraint : Constraint
    kinematics : Kinematics
        Positions and axes of frames, displacements of joints.
    q : casadi.SX
        Configuration, in the coordinates of `kinematics`.
    """
    if isinstance(constraint, Coupling):
        return _coupling(constraint, kinematics, q)
    a, b = constraint.frame_a, constraint.frame_b
    d = kinematics.frame_position(a, q) - kinematics.frame_position(b, q)
    if isinstance(constraint, Rod):
        return (ca.dot(d, d) - constraint.length**2) / 2
    axes_b = kinematics.frame_rotation(b, q)
    if isinstance(constraint, PointOnPlane):
        return ca.dot(_along(axes_b, constraint.normal), d)
    if isinstance(constraint, PointOnLine):
        return ca.vertcat(*[ca.dot(_along(axes_b, e), d) for e in perpendiculars(constraint.axis)])
    return ca.vertcat(axes_b.T @ d, *_orientation(constraint, kinematics, q, axes_b))


def _orientation(constraint: FrameConstraint, kinematics: Kinematics, q: ca.SX, axes_b: ca.SX) -> list[ca.SX]:
    if not isinstance(constraint, Hinge | Weld):
        return []
    axes_a = kinematics.frame_rotation(constraint.frame_a, q)
    if isinstance(constraint, Hinge):
        axis = _along(axes_a, constraint.axis_a)
        return [ca.dot(_along(axes_b, e), axis) for e in perpendiculars(constraint.axis_b)]
    return [ca.dot(axes_a[:, i], axes_b[:, j]) for i, j in ((1, 2), (2, 0), (0, 1))]


def _coupling(coupling: Coupling, kinematics: Kinematics, q: ca.SX) -> ca.SX:
    theta_a, theta_b = (kinematics.joint_displacement(j, q) for j in (coupling.joint_a, coupling.joint_b))
    value = theta_a - coupling.ratio * theta_b - coupling.offset
    if coupling.period is None:
        return value
    rate = 2.0 * np.pi / coupling.period
    return ca.atan2(ca.sin(rate * value), ca.cos(rate * value)) / rate


def _along(axes: ca.SX, direction: tuple[float, float, float]) -> ca.SX:
    """Direction in the world of a constant direction in a frame; nothing but a column where it is an axis."""
    terms = [axes[:, i] * number for i, number in enumerate(direction) if number]
    return sum(terms[1:], start=terms[0])
