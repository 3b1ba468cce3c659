"""Kinds of path constraints: velocity and acceleration of a frame in its own axes, as of wheels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp._keys import Key, Table
from mbocp.robot import FrameTarget
from mbocp.terms.coordinate_rows import CoordinateRows
from mbocp.terms.path_term import PathNumbers
from mbocp.terms.point import Point
from mbocp.terms.written import Range

_SHORTEST = 1e-9  # [m] a shorter way has no direction
_X, _Y = 0, 1


@dataclass(frozen=True)
class FrameVelocity(CoordinateRows):
    """Components of the velocity of the frame's origin along the axes of the frame.

    An axle that rolls along its x axis without slip keeps y at zero, as a knife edge does. That is the
    derivative of no constraint on positions: the frame may come to each place in each direction.
    """

    rolls: bool  # whether y is zero

    kind = "velocity"
    unit = "m/s"
    has_velocity = True
    size_of_errors = 0.1  # motions that are sent slip by a hundredth of it at most: 1 mm/s

    class Keys(Table):
        """Keys."""

        x: Annotated[
            Range, Key('of a `"velocity"`, along the axes of the frame', "m/s", beside=("y", "z"))
        ] = None
        y: Range = None
        z: Range = None

    @classmethod
    def of(cls, given: PathNumbers) -> FrameVelocity:
        """With its rows."""
        lower, upper = (dict(zip(given.axes, side, strict=True)) for side in (given.lower, given.upper))
        return cls(given.frame, given.axes, bool(lower.get(_Y) == upper.get(_Y) == 0.0))

    @property
    def leads(self) -> bool:  # type: ignore[override]
        """What rolls comes to a place beside it by a way that it can go."""
        return self.rolls

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Components [m/s]."""
        velocity = at.mechanics.frame_translation_jacobian(self.frame, at.q) @ at.v
        return (at.mechanics.frame_rotation(self.frame, at.q).T @ velocity)[list(self.axes)]

    def target(
        self, given: PathNumbers, name: str, ends: tuple[pin.SE3, pin.SE3], share: float
    ) -> FrameTarget | None:
        """On a cubic that begins and ends along the x axis, which points along it all the way."""
        if not self.rolls:
            return None
        start, end = ends
        ahead = end.translation - start.translation
        length = float(np.linalg.norm(ahead))
        if length < _SHORTEST:
            return FrameTarget.at(name, pin.SE3.Interpolate(start, end, share))
        along = _side(given, ahead, ends) * length * np.array([one.rotation[:, 0] for one in ends])
        place, slope = _cubic(share, ahead, along)
        x, z = np.sign(along[0] @ start.rotation[:, 0]) * slope / np.linalg.norm(slope), start.rotation[:, 2]
        rotation = np.column_stack([x, np.cross(z, x), z])
        return FrameTarget.at(name, pin.SE3(rotation, start.translation + place))


@dataclass(frozen=True)
class FrameAcceleration(CoordinateRows):
    """Components of the acceleration of the frame's origin along the axes of the frame, without gravity.

    Of an axle that rolls along its x axis x is how its speed changes, and y what pushes it sideways in
    bends. It is that of the mean acceleration of joints in each step, with the state at its end.
    """

    kind = "frame_acceleration"
    unit = "m/s^2"
    has_velocity = True
    remembers = ("acceleration",)

    class Keys(Table):
        """Keys."""

        x: Annotated[Range, Key('of a `"frame_acceleration"` likewise', "m/s^2", beside=("y", "z"))] = None
        y: Range = None
        z: Range = None

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Components [m/s^2]."""
        jacobian = at.mechanics.frame_translation_jacobian(self.frame, at.q)
        along = ca.jtimes(jacobian @ at.v, at.q, at.mechanics.joint_space.rate(at.q, at.v))
        acceleration = jacobian @ at.remembered["acceleration"] + along
        return (at.mechanics.frame_rotation(self.frame, at.q).T @ acceleration)[list(self.axes)]


def _side(given: PathNumbers, ahead: Array, ends: tuple[pin.SE3, pin.SE3]) -> float:
    """Forwards or backwards: as bounds of x say, else back where the goal is behind at both ends."""
    if _X in given.axes:
        at = given.axes.index(_X)
        if given.lower[at] >= 0.0 or given.upper[at] <= 0.0:
            return 1.0 if given.lower[at] >= 0.0 else -1.0
    return -1.0 if all(ahead @ one.rotation[:, 0] < 0.0 for one in ends) else 1.0


def _cubic(s: float, ahead: Array, along: Array) -> tuple[Array, Array]:
    """Place from the start, and slope, of a cubic that leads `ahead` with slopes `along` at both ends."""
    place = s**2 * (3 - 2 * s) * ahead + s * (1 - s) * ((1 - s) * along[0] - s * along[1])
    slope = 6 * s * (1 - s) * ahead + (1 - s) * (1 - 3 * s) * along[0] + s * (3 * s - 2) * along[1]
    return place, slope
