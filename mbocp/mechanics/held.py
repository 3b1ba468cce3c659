r"""Frames that are held along a part of the horizon: their equations, for steps, impacts and nodes.

With :math:`r = R_b^T (p_a - p_b)` and :math:`R = R_b^T R_a`, where frame a is in the axes of frame b, a frame
that is held *where it is* keeps them from one end of a step to the other,

.. math::
    \Phi(q_1; q_0) = \begin{pmatrix} r(q_1) - r(q_0) \\ (E - E^T)^\vee / 2 \end{pmatrix}, \qquad
    E = R(q_0)^T R(q_1)

of a weld; a point has the first three rows, a plane and a line have these along a normal or across a
direction, and a hinge has :math:`e_i^T E n` for both :math:`e_i` across its axis n. Steps add up, so
that a frame stays where it was when its span began: nothing has to remember where that is. Frames that
*coincide* have the rows of the loops of robots, see `mbocp.robot.loops.equations`.

What a hold pushes along, and what it leaves of velocities, is the derivative in q_1 where q_1 = q_0:

.. math:: J(q) = \partial_{q_1} \Phi(q_1; q_0) |_{q_0 = q_1 = q}.

At a solution E is the identity (or a turn about n), and its rows span those of the derivative in q_1.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.mechanics.joint import JointMechanics
from mbocp.mechanics.natural_coordinates.mechanics import NaturalMechanics
from mbocp.robot import Label, Robot, constraint_rows
from mbocp.robot.loops.constraints import (
    Axis,
    Constraint,
    FrameConstraint,
    Hinge,
    PointOnLine,
    PointOnPlane,
    Weld,
    perpendiculars,
)
from mbocp.robot.loops.coupling import Coupling

__all__ = [
    "Acting",
    "HeldFrame",
    "held_jacobian",
    "held_jacobians",
    "held_labels",
    "held_residuals",
    "held_rows",
]

_Mechanics: TypeAlias = JointMechanics | NaturalMechanics
_KEPT = 16  # functions


@dataclass(frozen=True)
class HeldFrame:
    """What is held, without the steps in which it is.

    Attributes
    ----------
    constraint : Constraint
    is_anchored : bool
        Whether frames are held where they are, and not in one place.
    """

    constraint: Constraint
    is_anchored: bool

    @property
    def rows(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        return self.constraint.rows

    def breaks_symmetries(self, robot: Robot) -> bool:
        """Whether it tells places or directions of the world apart, so that moving the robot changes it.

        What is held where it is moves along, unless a plane or a line of the world holds it.
        """
        if isinstance(self.constraint, Coupling):
            return False
        ends = (self.constraint.frame_a, self.constraint.frame_b)
        is_of_world = any(robot.model.frames[frame].parentJoint == 0 for frame in ends)
        has_direction = isinstance(self.constraint, PointOnPlane | PointOnLine)
        return is_of_world and (not self.is_anchored or has_direction)

    @property
    def signature(self) -> dict[str, Any]:
        """What its equations depend on."""
        said = dataclasses.asdict(self.constraint)
        said = {key: value for key, value in said.items() if key not in ("name", "frames")}
        return {"kind": self.constraint.kind, "is_anchored": self.is_anchored, **said}


@dataclass(frozen=True)
class Acting:
    """Which rows of constraints act for a while.

    Attributes
    ----------
    held : tuple of HeldFrame
    own : tuple of int
        Rows of the robot's constraints, of those that it keeps.
    rows : tuple of int
        Rows of the held frames.
    """

    held: tuple[HeldFrame, ...]
    own: tuple[int, ...]
    rows: tuple[int, ...]

    @property
    def signature(self) -> dict[str, Any]:
        """What the motion under it depends on."""
        held = [frame.signature for frame in self.held] if self.rows else []
        return {"held": held, "own": self.own, "rows": self.rows}


def held_labels(held: Sequence[HeldFrame]) -> tuple[Label, ...]:
    """Name and unit of each row of all of them."""
    return tuple(label for frame in held for label in frame.rows)


def held_rows(held: Sequence[HeldFrame], mechanics: _Mechanics, q: ca.SX, anchor: ca.SX) -> ca.SX:
    """Phi(q; anchor) of all held frames, one below the other [m, rad]."""
    return ca.vertcat(ca.SX.zeros(0, 1), *(_rows(frame, mechanics, q, anchor) for frame in held))


def held_jacobian(held: Sequence[HeldFrame], mechanics: _Mechanics, q: ca.SX) -> ca.SX:
    """J(q) of all held frames in tangent coordinates, shape (rows, nv)."""
    if not held:
        return ca.SX.zeros(0, mechanics.nv)
    at, anchor = ca.SX.sym("q", mechanics.nq), ca.SX.sym("anchor", mechanics.nq)
    jacobian = ca.jacobian(held_rows(held, mechanics, at, anchor), at) @ mechanics.tangent_map(at)
    return ca.Function("held", [at, anchor, mechanics.symbols], [jacobian])(q, q, mechanics.symbols)


def held_jacobians(robot: Robot, held: Sequence[HeldFrame], qs: Array) -> Array:
    """J at n configurations, shape (n, rows, nv)."""
    function = _functions(robot, tuple(held))[1].map(len(qs))
    found = np.asarray(function(qs.T)).reshape(-1, len(qs), robot.nv)
    return np.ascontiguousarray(found.transpose(1, 0, 2))


def held_residuals(robot: Robot, held: Sequence[HeldFrame], qs: Array, anchors: Array) -> Array:
    """Phi at n configurations from n anchors, shape (n, rows) [m, rad]."""
    found: Array = np.asarray(_functions(robot, tuple(held))[0].map(len(qs))(qs.T, anchors.T)).T
    return found


@lru_cache(maxsize=_KEPT)
def _functions(robot: Robot, held: tuple[HeldFrame, ...]) -> tuple[ca.Function, ca.Function]:
    mechanics = JointMechanics(robot)
    q, anchor = ca.SX.sym("q", robot.nq), ca.SX.sym("anchor", robot.nq)
    rows, jacobian = held_rows(held, mechanics, q, anchor), held_jacobian(held, mechanics, q)
    # Columns of the Jacobian one after the other: maps join them sideways.
    return (
        ca.Function("rows", [q, anchor], [ca.densify(rows)]),
        ca.Function("jacobian", [q], [ca.densify(jacobian)]),
    )


def _rows(held: HeldFrame, mechanics: _Mechanics, q: ca.SX, anchor: ca.SX) -> ca.SX:
    constraint = held.constraint
    if not held.is_anchored or isinstance(constraint, Coupling):
        return constraint_rows(constraint, mechanics, q)
    moved = _place(constraint, mechanics, q) - _place(constraint, mechanics, anchor)
    if isinstance(constraint, PointOnPlane):
        return _along(constraint.normal, moved)
    if isinstance(constraint, PointOnLine):
        return ca.vertcat(*[_along(e, moved) for e in perpendiculars(constraint.axis)])
    if not isinstance(constraint, Hinge | Weld):
        return moved
    E = _attitude(constraint, mechanics, anchor).T @ _attitude(constraint, mechanics, q)
    if isinstance(constraint, Weld):
        return ca.vertcat(moved, ca.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]) / 2)
    axis = E @ ca.DM(np.array(constraint.axis_a))
    return ca.vertcat(moved, *[_along(e, axis) for e in perpendiculars(constraint.axis_a)])


def _place(constraint: FrameConstraint, mechanics: _Mechanics, q: ca.SX) -> ca.SX:
    """Origin of frame a from that of frame b, in the axes of b."""
    a, b = constraint.frame_a, constraint.frame_b
    between = mechanics.frame_position(a, q) - mechanics.frame_position(b, q)
    return mechanics.frame_rotation(b, q).T @ between


def _attitude(constraint: FrameConstraint, mechanics: _Mechanics, q: ca.SX) -> ca.SX:
    """Axes of frame a in those of frame b."""
    axes = mechanics.frame_rotation(constraint.frame_b, q)
    return axes.T @ mechanics.frame_rotation(constraint.frame_a, q)


def _along(direction: Axis, vector: ca.SX) -> ca.SX:
    return ca.dot(ca.DM(np.array(direction)), vector)
