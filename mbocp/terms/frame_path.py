"""Kinds of path constraints on the place and the speed of a frame, and on the mass of all of the robot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import casadi as ca
import numpy as np

from mbocp._arrays import dataclass
from mbocp._keys import Key, Table
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.robot import Robot
from mbocp.terms.coordinate_rows import CoordinateRows
from mbocp.terms.path_term import (
    COSINE,
    SQUARE,
    VALUE,
    Measure,
    PathNumbers,
    PathTerm,
    finite_bounds,
    one_bound,
)
from mbocp.terms.point import Point
from mbocp.terms.written import Bound, Range, Triple

_HISTORIC: Mapping[str, int] = {"point": 3}  # every kind of the first release has one, used or not


@dataclass(frozen=True)
class Position(CoordinateRows):
    """Coordinates of the frame's origin in the world."""

    kind = "position"
    unit = "m"
    sizes = _HISTORIC

    class Keys(Table):
        """Keys."""

        x: Annotated[
            Range,
            Key(
                'of a `"position"`, a `"centre_of_mass"`: `[lower, upper]` in the world',
                "m",
                beside=("y", "z"),
            ),
        ] = None
        y: Range = None
        z: Range = None

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Coordinates [m]."""
        return at.mechanics.frame_position(self.frame, at.q)[list(self.axes)]


@dataclass(frozen=True)
class Distance(PathTerm):
    """Distance of the frame's origin from that of another, or from a point of the world."""

    other: int | None

    kind = "distance"
    unit = "m"
    measure = SQUARE  # smooth at zero
    sizes = _HISTORIC

    class Keys(Table):
        """Keys."""

        frame_b: Annotated[
            str | None,
            Key(
                'of a `"distance"`: from the origin of another frame, or a point of the world',
                "m",
                default="one of the two",
                takes="string or 3 numbers",
                beside=("point",),
            ),
        ] = None
        point: Triple = None
        min: Annotated[Bound, Key("of a distance", "m", beside=("max",))] = None
        max: Bound = None

    @classmethod
    def of(cls, given: PathNumbers) -> Distance:
        """With the other frame."""
        return cls(given.frame, given.other)

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Other end and bounds."""
        bounds = one_bound(given, key)
        if ("frame_b" in given) == ("point" in given):
            raise ProblemError(f"{key}: a distance is between two things; give frame_b or point")
        other = given.get("frame_b")
        return {
            "other": None if other is None else robot.frame_id(other),
            "point": given.get("point", np.zeros(3)),
            **bounds,
        }

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """Other end and bounds."""
        if given.other is not None:
            return {"frame_b": robot.frame_names[given.other], **finite_bounds(given)}
        return {"point": given.number("point"), **finite_bounds(given)}

    @classmethod
    def check(cls, given: PathNumbers, key: str) -> None:
        """Refuse a distance that is zero, whose square has no slope."""
        super().check(given, key)
        if given.upper[0] <= 0.0:
            raise InvalidValue(
                f"{key}: max", float(given.upper[0]), 'a length above 0 (kind = "position" for a point)'
            )

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Square of the distance [m^2]."""
        position = at.mechanics.frame_position(self.frame, at.q)
        away = p["point"] if self.other is None else at.mechanics.frame_position(self.other, at.q)
        return ca.sumsqr(position - away)


class _SpeedBounds(PathTerm):
    """A speed; one that is to be above zero is for a part of the motion, which begins and ends at rest."""

    has_velocity = True
    measure = SQUARE  # smooth at zero

    @classmethod
    def check(cls, given: PathNumbers, key: str) -> None:
        """Refuse a magnitude below zero."""
        if cls.of(given).measures == (SQUARE,) and given.upper[0] < 0.0:
            raise InvalidValue(f"{key}: max", float(given.upper[0]), "a speed, which is not below 0")


@dataclass(frozen=True)
class Speed(_SpeedBounds):
    """Speed of the frame's origin, or its velocity along a direction in the world."""

    is_along: bool = False

    kind = "speed"
    unit = "m/s"

    class Keys(Table):
        """Keys."""

        min: Annotated[Bound, Key("of a speed; both equal: a constant one", "m/s", beside=("max",))] = None
        max: Bound = None
        direction: Triple = None

    @classmethod
    def of(cls, given: PathNumbers) -> Speed:
        """With what it has a direction."""
        return cls(given.frame, "direction" in given.further)

    @property
    def sizes(self) -> Mapping[str, int]:  # type: ignore[override]
        """The direction, if there is one."""
        return {"direction": 3} if self.is_along else _HISTORIC

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Bounds, and the direction."""
        along = {"direction": given["direction"]} if "direction" in given else {}
        return {**along, **one_bound(given, key)}

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """Bounds, and the direction."""
        along = {"direction": given.number("direction")} if cls.of(given).is_along else {}
        return {**along, **finite_bounds(given)}

    @classmethod
    def check(cls, given: PathNumbers, key: str) -> None:
        """Refuse a vector without a direction, and a magnitude below zero."""
        super().check(given, key)
        along = given.number("direction") if cls.of(given).is_along else np.ones(3)
        if not (np.isfinite(along).all() and along.any()):
            raise InvalidValue(f"{key}: direction", along.tolist(), "a direction")

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Square of the speed [m^2/s^2]; along a direction the velocity [m/s]."""
        velocity = at.mechanics.frame_translation_jacobian(self.frame, at.q) @ at.v
        if self.is_along:
            return ca.dot(p["direction"], velocity) / ca.norm_2(p["direction"])
        return ca.sumsqr(velocity)

    @property
    def measures(self) -> tuple[Measure, ...]:
        """Of a velocity itself: that is smooth at zero."""
        return (VALUE if self.is_along else SQUARE,)


@dataclass(frozen=True)
class AngularSpeed(_SpeedBounds):
    """Magnitude of the frame's angular velocity."""

    kind = "angular_speed"
    unit = "rad/s"

    class Keys(Table):
        """Keys."""

        min: Annotated[Bound, Key("of an angular speed", "rad/s", beside=("max",))] = None
        max: Bound = None

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Square of the angular speed [rad^2/s^2]."""
        return ca.sumsqr(at.mechanics.frame_rotation_jacobian(self.frame, at.q) @ at.v)


@dataclass(frozen=True)
class Orientation(PathTerm):
    """Angle between an axis of the frame and a direction in the world, kept as its cosine."""

    kind = "orientation"
    unit = "rad"
    measure = COSINE
    sizes: ClassVar[Mapping[str, int]] = {"axis": 3, "direction": 3}
    defaults: ClassVar[Mapping[str, Any]] = dict.fromkeys(sizes, (0.0, 0.0, 1.0))

    class Keys(Table):
        """Keys."""

        axis: Annotated[
            Triple,
            Key(
                'of an `"orientation"`: axis in the frame, direction in the world; of a `"follow"` the axis; '
                "of a speed the direction",
                default="z",
                beside=("direction",),
            ),
        ] = None
        direction: Triple = None
        min: Annotated[Bound, Key("of an orientation, or to a path", "rad", beside=("max",))] = None
        max: Bound = None

    @classmethod
    def check(cls, given: PathNumbers, key: str) -> None:
        """Refuse vectors without a direction, and angles that are none."""
        super().check(given, key)
        for name in cls.sizes:
            if not given.number(name).any():
                raise InvalidValue(f"{key}: {name}", [0.0, 0.0, 0.0], "a direction")
        for name, value in finite_bounds(given).items():
            if not 0.0 < value < np.pi:
                raise InvalidValue(f"{key}: {name}", value, "an angle between 0 and pi [rad]")

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Cosine of the angle."""
        axis = at.mechanics.frame_rotation(self.frame, at.q) @ p["axis"]
        return ca.dot(p["direction"], axis) / ca.sqrt(ca.sumsqr(p["direction"]) * ca.sumsqr(p["axis"]))


@dataclass(frozen=True)
class CentreOfMass(CoordinateRows):
    """Coordinates of the centre of mass in the world."""

    kind = "centre_of_mass"
    unit = "m"
    of_robot = True
    Keys = Position.Keys

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Coordinates [m]."""
        return at.mechanics.centre_of_mass(at.q)[list(self.axes)]


@dataclass(frozen=True)
class AngularMomentum(CoordinateRows):
    """Components of the angular momentum about the centre of mass, in the axes of the world."""

    kind = "angular_momentum"
    unit = "N m s"
    of_robot = True
    has_velocity = True

    class Keys(Table):
        """Keys."""

        x: Annotated[
            Range, Key("of an angular momentum about the centre of mass", "N m s", beside=("y", "z"))
        ] = None
        y: Range = None
        z: Range = None

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Components [N m s]."""
        return at.mechanics.centroidal_momentum(at.q, at.v)[3:][list(self.axes)]
