r"""Frames that are held along a part of the horizon: their equations, for steps, impacts and nodes.

A frame that is held *where it is* keeps the rows of its constraint from one end of a step to the other,
:math:`\Phi(q_1; q_0) = 0`, see `Constraint.change_from`. Steps add up, so that a frame stays where it was
when its span began: nothing has to remember where that is. Frames that *coincide* have the rows of the loops
of robots, see `Constraint.equations`. Both are those of `mbocp.robot.loops.kinds`.

What a hold pushes along, and what it leaves of velocities, is the derivative in q_1 where q_1 = q_0:

.. math:: J(q) = \partial_{q_1} \Phi(q_1; q_0) |_{q_0 = q_1 = q}.

At a solution the frame is where it was (or turned about its axis), and the rows of J span those of the
derivative in q_1.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.mechanics.either import Mechanics
from mbocp.mechanics.joint_mechanics import JointMechanics
from mbocp.robot import Label, Robot
from mbocp.robot.loops.kinds.constraint import Constraint

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
        ends = self.constraint.frame_ids
        is_of_world = any(robot.model.frames[frame].parentJoint == 0 for frame in ends)
        return is_of_world and (not self.is_anchored or self.constraint.is_directed)

    @property
    def signature(self) -> dict[str, Any]:
        """What its equations depend on."""
        said = dataclasses.asdict(self.constraint)
        said = {key: value for key, value in said.items() if key not in ("name", "frames")}
        return {"kind": self.constraint.kind, "is_anchored": self.is_anchored, **said}


@dataclass(frozen=True)
class ActiveRows:
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


def label_held(held: Sequence[HeldFrame]) -> tuple[Label, ...]:
    """Name and unit of each row of all of them."""
    return tuple(label for frame in held for label in frame.rows)


def write_held_rows(held: Sequence[HeldFrame], mechanics: Mechanics, q: ca.SX, anchor: ca.SX) -> ca.SX:
    """Phi(q; anchor) of all held frames, one below the other [m, rad]."""
    return ca.vertcat(ca.SX.zeros(0, 1), *(_rows(frame, mechanics, q, anchor) for frame in held))


def write_held_jacobian(held: Sequence[HeldFrame], mechanics: Mechanics, q: ca.SX) -> ca.SX:
    """J(q) of all held frames in tangent coordinates, shape (rows, nv)."""
    if not held:
        return ca.SX.zeros(0, mechanics.nv)
    at, anchor = ca.SX.sym("q", mechanics.nq), ca.SX.sym("anchor", mechanics.nq)
    jacobian = ca.jacobian(write_held_rows(held, mechanics, at, anchor), at) @ mechanics.tangent_map(at)
    return ca.Function("held", [at, anchor, mechanics.symbols], [jacobian])(q, q, mechanics.symbols)


def compute_held_jacobians(robot: Robot, held: Sequence[HeldFrame], qs: Array) -> Array:
    """J at n configurations, shape (n, rows, nv)."""
    found = _along(_functions(robot, tuple(held))[1], qs).reshape(len(qs), robot.nv, -1)
    return np.ascontiguousarray(found.transpose(0, 2, 1))


def compute_held_residuals(robot: Robot, held: Sequence[HeldFrame], qs: Array, anchors: Array) -> Array:
    """Phi at n configurations from n anchors, shape (n, rows) [m, rad]."""
    return _along(_functions(robot, tuple(held))[0], qs, anchors)


def _along(function: ca.Function, *arguments: Array) -> Array:
    """Numbers of a function, column by column, at n rows of its arguments, shape (n, numbers).

    They are read and written where they are: to make matrices of CasADi of them takes ten times as long.
    """
    buffer: Any
    buffer, evaluate = function.buffer()
    rows = [np.array(argument, dtype=np.float64, order="C") for argument in arguments]
    found = np.empty((len(rows[0]), function.nnz_out(0)))
    for node, numbers in enumerate(found):
        for place, argument in enumerate(rows):
            buffer.set_arg(place, argument[node].data)
        buffer.set_res(0, numbers.data)
        evaluate()
    return found


@lru_cache(maxsize=_KEPT)
def _functions(robot: Robot, held: tuple[HeldFrame, ...]) -> tuple[ca.Function, ca.Function]:
    mechanics = JointMechanics(robot)
    q, anchor = ca.SX.sym("q", robot.nq), ca.SX.sym("anchor", robot.nq)
    rows, jacobian = write_held_rows(held, mechanics, q, anchor), write_held_jacobian(held, mechanics, q)
    return (
        ca.Function("rows", [q, anchor], [ca.densify(rows)]),
        ca.Function("jacobian", [q], [ca.densify(jacobian)]),
    )


def _rows(held: HeldFrame, mechanics: Mechanics, q: ca.SX, anchor: ca.SX) -> ca.SX:
    if held.is_anchored:
        return held.constraint.change_from(mechanics, q, anchor)
    return held.constraint.equations(mechanics, q)
