"""What a path constraint is, and the kinds that a problem file knows.

A class is a kind of constraint on a frame: its keys in `[[path]]`, its expression, names and units of its
rows. An instance is the structure of a constraint: all that its function depends on, and no number.

Defining a class adds it to `PATH_TERMS`; schema, parameters, the text of a problem, labels and the
documentation follow from there. `mbocp.problem.PathConstraint` holds the numbers.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Protocol

import casadi as ca
import numpy as np
import pinocchio as pin
from pydantic import Field

from mbocp._arrays import Array
from mbocp._text import shown
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.robot import Label, Robot
from mbocp.terms.point import Point
from mbocp.terms.written import Bound, Finite, Key, Range, Table

__all__ = [
    "PATH_TERMS",
    "AngularSpeed",
    "Distance",
    "Orientation",
    "PathNumbers",
    "PathTerm",
    "Position",
    "Speed",
]

PATH_TERMS: dict[str, type[PathTerm]] = {}  # by kind, in the order in which they are documented
_AXES = "xyz"


class PathNumbers(Protocol):
    """What terms ask of `mbocp.problem.PathConstraint`."""

    @property
    def name(self) -> str:
        """What it is called."""

    @property
    def frame(self) -> int:
        """Index of the frame."""

    @property
    def other(self) -> int | None:
        """Index of another frame."""

    @property
    def axes(self) -> tuple[int, ...]:
        """Rows of a position."""

    @property
    def lower(self) -> Array:
        """Lower bounds."""

    @property
    def upper(self) -> Array:
        """Upper bounds."""

    def number(self, key: str) -> Array:
        """Value of one of its parameters."""


@dataclass(frozen=True)
class PathTerm(ABC):
    """A constraint on a frame, see the module.

    Attributes
    ----------
    kind : str
    unit : str
        Of its bounds.
    sizes : mapping
        Size of each parameter.
    has_velocity : bool
        Whether it depends on the velocity.
    remembers : tuple of str
        Names of what a state remembers for it of the step before a node.
    frame : int
        Index of the frame.
    """

    frame: int

    kind: ClassVar[str]
    unit: ClassVar[str]
    sizes: ClassVar[Mapping[str, int]] = {}
    has_velocity: ClassVar[bool] = False
    remembers: ClassVar[tuple[str, ...]] = ()
    Keys: ClassVar[type[Table]]

    def __init_subclass__(cls) -> None:
        if "kind" in cls.__dict__:
            PATH_TERMS[cls.kind] = cls

    @classmethod
    def of(cls, given: PathNumbers) -> PathTerm:
        """The structure of a constraint."""
        return cls(given.frame)

    @classmethod
    def completed(
        cls, given: Mapping[str, Any], start: pin.SE3, end: Array | None, key: str
    ) -> dict[str, Any]:
        """The keys that are written, with those that follow from the start and the goal of the frame.

        Parameters
        ----------
        start : pinocchio.SE3
            Placement of the frame at the start.
        end : ndarray, shape (3,), optional
            Position of the frame at the goal, where that says it [m].
        """
        return dict(given)

    @classmethod
    @abstractmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Arguments of `PathConstraint` from the keys that are written, beside name, kind and frame."""

    @classmethod
    @abstractmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """Keys that read back as the same, beside name, kind and frame."""

    @abstractmethod
    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Its function at a point, smooth wherever a motion may be, with its parameters by name."""

    @property
    def signature(self) -> dict[str, Any]:
        """What its function depends on."""
        return {"term": self.kind, **dataclasses.asdict(self)}

    @property
    def rows(self) -> int:
        """Number of inequalities."""
        return 1

    @classmethod
    def check(cls, given: PathNumbers, key: str) -> None:
        """Refuse numbers that the kind has no use for."""
        for name in cls.sizes:
            if not np.isfinite(given.number(name)).all():
                raise InvalidValue(f"{key}: {name}", shown(given.number(name).tolist()), "finite numbers")

    @classmethod
    def labels(cls, given: PathNumbers) -> tuple[Label, ...]:
        """Name and unit of each row."""
        return (Label(given.name, cls.unit),)

    @classmethod
    def inner(cls, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        """Bounds of the expression, from those of the value that people speak of."""
        return bounds

    @classmethod
    def value(cls, h: Array) -> Array:
        """The value that people speak of, from that of the expression."""
        return h

    @classmethod
    def slope(cls, value: Array) -> Array:
        """Derivative of the expression in the value."""
        return np.ones_like(value)


class _Squared(PathTerm):
    """One length or speed, kept as its square, which is smooth at zero."""

    @classmethod
    def inner(cls, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        """Squares with the sign of the bound."""
        lower, upper = (np.sign(b) * b**2 for b in bounds)
        return lower, upper

    @classmethod
    def value(cls, h: Array) -> Array:
        """Square root."""
        root: Array = np.sqrt(h)
        return root

    @classmethod
    def slope(cls, value: Array) -> Array:
        """d(h^2) = 2 h dh."""
        return 2.0 * value


_HISTORIC = {"point": 3}  # every kind of the first release has one, used or not


@dataclass(frozen=True)
class Position(PathTerm):
    """Coordinates of the frame's origin in the world."""

    axes: tuple[int, ...]

    kind = "position"
    unit = "m"
    sizes = _HISTORIC

    class Keys(Table):
        """Keys."""

        x: Annotated[
            Range,
            Key("pair", "m", "none", 'kind `"position"`: `[lower, upper]` in the world', ("y", "z")),
        ] = None
        y: Range = None
        z: Range = None

    @classmethod
    def of(cls, given: PathNumbers) -> Position:
        """With its rows."""
        return cls(given.frame, given.axes)

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Rows and bounds."""
        axes = tuple(i for i, axis in enumerate(_AXES) if axis in given)
        if not axes:
            raise ProblemError(f"{key}: bounds nothing; give x, y or z as [lower, upper]")
        lower, upper = np.array([given[_AXES[i]] for i in axes]).T
        return {"axes": axes, "lower": lower, "upper": upper}

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """A pair for each row."""
        sides = zip(given.axes, given.lower, given.upper, strict=True)
        return {_AXES[i]: [low, high] for i, low, high in sides}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Coordinates [m]."""
        return at.mechanics.frame_position(self.frame, at.q)[list(self.axes)]

    @property
    def rows(self) -> int:
        """One for each axis."""
        return len(self.axes)

    @classmethod
    def labels(cls, given: PathNumbers) -> tuple[Label, ...]:
        """The axis behind the name."""
        return tuple(Label(f"{given.name}.{_AXES[i]}", cls.unit) for i in given.axes)


@dataclass(frozen=True)
class Distance(_Squared):
    """Distance of the frame's origin from that of another, or from a point of the world."""

    other: int | None

    kind = "distance"
    unit = "m"
    sizes = _HISTORIC

    class Keys(Table):
        """Keys."""

        frame_b: Annotated[
            str | None,
            Key(
                "string or 3 numbers",
                "m",
                "one of the two",
                'kind `"distance"`: from the origin of another frame, or from a point of the world',
                ("point",),
            ),
        ] = None
        point: Annotated[list[Finite] | None, Field(min_length=3, max_length=3)] = None
        min: Annotated[Bound, Key("number", "m", "none", "of a distance", ("max",))] = None
        max: Bound = None

    @classmethod
    def of(cls, given: PathNumbers) -> Distance:
        """With the other frame."""
        return cls(given.frame, given.other)

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Other end and bounds."""
        bounds = one_bound(given, key, "min or max")
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


class _Bounded(_Squared):
    """A speed, which has an upper bound alone."""

    has_velocity = True

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """The bound."""
        return one_bound(given, key, "max")

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """The bound."""
        return finite_bounds(given)


@dataclass(frozen=True)
class Speed(_Bounded):
    """Speed of the frame's origin."""

    kind = "speed"
    unit = "m/s"
    sizes = _HISTORIC

    class Keys(Table):
        """Keys."""

        max: Annotated[Bound, Key("number", "m/s", "none", "`max` of a speed")] = None

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Square of the speed [m^2/s^2]."""
        return ca.sumsqr(at.mechanics.frame_translation_jacobian(self.frame, at.q) @ at.v)


@dataclass(frozen=True)
class AngularSpeed(_Bounded):
    """Magnitude of the frame's angular velocity."""

    kind = "angular_speed"
    unit = "rad/s"

    class Keys(Table):
        """Keys."""

        max: Annotated[Bound, Key("number", "rad/s", "none", "`max` of an angular speed")] = None

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Square of the angular speed [rad^2/s^2]."""
        return ca.sumsqr(at.mechanics.frame_rotation_jacobian(self.frame, at.q) @ at.v)


@dataclass(frozen=True)
class Orientation(PathTerm):
    """Angle between an axis of the frame and a direction in the world, kept as its cosine."""

    kind = "orientation"
    unit = "rad"
    sizes: ClassVar[Mapping[str, int]] = {"axis": 3, "direction": 3}

    class Keys(Table):
        """Keys."""

        axis: Annotated[
            Annotated[list[Finite] | None, Field(min_length=3, max_length=3)],
            Key(
                "3 numbers",
                "",
                "z",
                'kind `"orientation"`: axis in the frame, and direction in the world '
                "from which it is bent by an angle of at least `min` and at most `max`",
                ("direction",),
            ),
        ] = None
        direction: Annotated[list[Finite] | None, Field(min_length=3, max_length=3)] = None
        min: Annotated[Bound, Key("number", "rad", "none", "of an orientation", ("max",))] = None
        max: Bound = None

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Axis, direction and bounds."""
        along_z = [0.0, 0.0, 1.0]
        vectors = {name: given.get(name, along_z) for name in cls.sizes}
        return {**vectors, **one_bound(given, key, "min or max")}

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """Axis, direction and bounds."""
        return {**{name: given.number(name) for name in cls.sizes}, **finite_bounds(given)}

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

    @classmethod
    def inner(cls, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        """Cosines, which fall where angles rise."""
        lower, upper = bounds
        return (
            np.where(np.isfinite(upper), np.cos(np.where(np.isfinite(upper), upper, 0.0)), -np.inf),
            np.where(np.isfinite(lower), np.cos(np.where(np.isfinite(lower), lower, 0.0)), np.inf),
        )

    @classmethod
    def value(cls, h: Array) -> Array:
        """Angle [rad]."""
        angle: Array = np.arccos(np.clip(h, -1.0, 1.0))
        return angle

    @classmethod
    def slope(cls, value: Array) -> Array:
        """Derivative of the cosine."""
        return -np.sin(value)


def one_bound(given: Mapping[str, Any], key: str, names: str) -> dict[str, Any]:
    """Bounds of one row from `min` and `max`."""
    if "min" not in given and "max" not in given:
        raise ProblemError(f"{key}: bounds nothing; give {names}")
    return {"lower": [given.get("min", -np.inf)], "upper": [given.get("max", np.inf)]}


def finite_bounds(given: PathNumbers) -> dict[str, float]:
    """`min` and `max` of one row, where there are any."""
    sides = (("min", given.lower[0]), ("max", given.upper[0]))
    return {key: value for key, value in sides if np.isfinite(value)}
