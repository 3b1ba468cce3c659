"""What each kind of joint asks of two bodies in natural coordinates."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.mechanics.natural_coordinates.bodies import TURNING, Body


class JointRow(NamedTuple):
    """One constraint: the body that it belongs to, its name among that body's, unit and value."""

    body: Body
    name: str
    unit: str
    value: ca.SX


def joint_rows(body: Body, axes: ca.SX, away: ca.SX, D: ca.SX) -> Iterator[JointRow]:
    """Constraints of a body's joint.

    Parameters
    ----------
    body : Body
    axes : casadi.SX, shape (3, 3)
        Axes of the joint on the parent, in the world.
    away : casadi.SX, shape (3,)
        From the joint's place on the parent to the body's origin, in world axes [m].
    D : casadi.SX, shape (3, 3)
        Axes of the body in the world.

    Yields
    ------
    JointRow
        Of second degree in the coordinates of both bodies.
    """
    for rows in _ROWS[body.kind]:
        yield from rows(body, axes, away, D)


def _place(body: Body, axes: ca.SX, away: ca.SX, D: ca.SX) -> Iterator[JointRow]:
    for i, letter in enumerate("xyz"):
        yield JointRow(body, f"joint {letter}", "m", away[i])


def _axis(body: Body, axes: ca.SX, away: ca.SX, D: ca.SX) -> Iterator[JointRow]:
    own = D @ ca.DM(body.axis)
    for i, other in enumerate(perpendiculars(body.axis)):
        yield JointRow(body, f"axis {i + 1}", "", ca.dot(axes @ ca.DM(other), own))


def _turns(body: Body, axes: ca.SX, away: ca.SX, D: ca.SX) -> Iterator[JointRow]:
    for i, j in ((0, 1), (1, 2), (2, 0)):
        yield JointRow(body, f"turn {i + 1}", "", ca.dot(axes[:, i], D[:, j]))


def _aside(body: Body, axes: ca.SX, away: ca.SX, D: ca.SX) -> Iterator[JointRow]:
    for i, other in enumerate(perpendiculars(body.axis)):
        yield JointRow(body, f"aside {i + 1}", "m", ca.dot(axes @ ca.DM(other), away))


def _plane(body: Body, axes: ca.SX, away: ca.SX, D: ca.SX) -> Iterator[JointRow]:
    yield JointRow(body, "height", "m", ca.dot(axes[:, 2], away))
    for i in range(2):
        yield JointRow(body, f"tilt {i + 1}", "", ca.dot(axes[:, i], D[:, 2]))


_ROWS = {
    "floating": (),
    "spherical": (_place,),
    "revolute": (_place, _axis),
    "continuous": (_place, _axis),
    "translation": (_turns,),
    "prismatic": (_turns, _aside),
    "planar": (_plane,),
}


def follower_row(body: Body, own: ca.SX, leaders: ca.SX) -> JointRow:
    """What ties a follower (mimic joint) to its leader, given the displacements of both [rad, m].

    An angle is known up to full turns: a follower that turns is at the place nearest to where it stands. That
    is the right one however far it has turned, if its leader is known, or turns it by whole turns.
    """
    value = own - body.ratio * leaders
    if body.kind not in TURNING:
        return JointRow(body, "follows", "m", value)
    return JointRow(body, "follows", "rad", ca.atan2(ca.sin(value), ca.cos(value)))


def perpendiculars(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors that make a right-handed system with the unit vector `axis`: b1 x b2 = axis."""
    start = np.eye(3)[(int(np.argmax(np.abs(axis))) + 1) % 3]
    first = start - axis * (axis @ start)
    first = first / np.linalg.norm(first)
    return first, np.cross(axis, first)
