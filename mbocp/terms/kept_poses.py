"""Path constraints that keep a frame on a straight line, or its orientation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp._keys import Key, Table
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.lie.groups import vee
from mbocp.robot import FrameTarget, Label, Robot
from mbocp.robot.poses.target import normals_to
from mbocp.terms.path_term import COSINE, SQUARE, VALUE, Measure, PathNumbers, PathTerm
from mbocp.terms.point import Point
from mbocp.terms.written import Finite, NonNegative, Triple

_SHORTEST = 1e-9  # [m] a shorter line has no direction
_OVERSHOOT = 1e-3  # of a segment's length: room for solvers where start and goal are its ends


@dataclass(frozen=True)
class Line(PathTerm):
    """The frame's origin on a straight line, or within a distance of it, and between two points of it."""

    is_exact: bool
    is_segment: bool

    kind = "line"
    unit = "m"
    leads = True
    sizes: ClassVar[Mapping[str, int]] = {"a": 3, "b": 3, "normals": 6}

    class Keys(Table):
        """Keys."""

        a: Annotated[
            Triple,
            Key(
                'two points of a `"line"`',
                "m",
                default="where the frame is at the start, and its goal",
                takes="3 numbers each",
                beside=("b",),
            ),
        ] = None
        b: Triple = None
        segment: Annotated[
            bool | None, Key('whether it stays between the points of a `"line"`', default="false")
        ] = None
        tolerance: Annotated[
            NonNegative | None,
            Key("how far from a line, path or orientation; 0: an equation", "m, rad", default="0"),
        ] = None

    @classmethod
    def of(cls, given: PathNumbers) -> Line:
        """Two equations, or a bound on the distance, and bounds along the line."""
        is_exact = bool(given.lower[0] == 0.0)
        return cls(given.frame, is_exact, len(given.lower) > (2 if is_exact else 1))

    @classmethod
    def complete(
        cls, given: Mapping[str, Any], start: pin.SE3, end: Array | None, key: str
    ) -> dict[str, Any]:
        """From where the frame is at the start to the position of its goal."""
        found = {"a": start.translation, **({"b": end} if end is not None else {}), **given}
        if "b" not in found:
            raise ProblemError(f"{key}: where does the line end? Give b, or a position in goal.frame")
        return found

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Points, directions normal to the line, and bounds."""
        a, b = np.array(given["a"], dtype=np.float64), np.array(given["b"], dtype=np.float64)
        length = float(np.linalg.norm(b - a))
        if not length > _SHORTEST:
            raise InvalidValue(f"{key}: b", b.tolist(), f"another point than a, {a.tolist()}")
        normals = normals_to((b - a) / length).ravel(order="F")
        bounds = _within(given, 2, key)
        if given.get("segment", False):
            over = _OVERSHOOT * length
            bounds = {"lower": [*bounds["lower"], -over], "upper": [*bounds["upper"], length + over]}
        return {"a": a, "b": b, "normals": normals, **bounds}

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """Points and tolerance."""
        return {
            "a": given.number("a"),
            "b": given.number("b"),
            **({"segment": True} if cls.of(given).is_segment else {}),
            "tolerance": float(given.upper[0]),
        }

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Distances normal to the line [m], or their squares [m^2]; how far from a along it [m]."""
        away = at.mechanics.frame_position(self.frame, at.q) - p["a"]
        aside = ca.reshape(p["normals"], 3, 2).T @ away
        rows = aside if self.is_exact else ca.sumsqr(aside)
        if not self.is_segment:
            return rows
        ahead = p["b"] - p["a"]
        return ca.vertcat(rows, ca.dot(ahead, away) / ca.norm_2(ahead))

    @property
    def measures(self) -> tuple[Measure, ...]:
        """Squares of distances, unless they are zero."""
        return (*((VALUE, VALUE) if self.is_exact else (SQUARE,)), *((VALUE,) if self.is_segment else ()))

    @property
    def rows(self) -> int:
        """Two directions, or one distance; and the distance along the line."""
        return len(self.measures)

    def draw(self, given: PathNumbers) -> Array | None:
        """Both ends."""
        return np.array([given.number("a"), given.number("b")])

    def target(
        self, given: PathNumbers, name: str, ends: tuple[pin.SE3, pin.SE3], share: float
    ) -> FrameTarget | None:
        """On the straight line from the start to the goal."""
        start, end = (placement.translation for placement in ends)
        return FrameTarget(name=name, position=start + share * (end - start))

    @classmethod
    def labels(cls, given: PathNumbers) -> tuple[Label, ...]:
        """Distances."""
        term = cls.of(given)
        along = (Label(f"{given.name}.along", cls.unit),) if term.is_segment else ()
        return (*_number(given.name, 2 if term.is_exact else 1, cls.unit), *along)


@dataclass(frozen=True)
class OrientationKept(PathTerm):
    """The frame turned by no more than an angle from an orientation."""

    is_exact: bool

    kind = "orientation_kept"
    unit = "rad"
    sizes: ClassVar[Mapping[str, int]] = {"rotation": 9}

    class Keys(Table):
        """Keys."""

        rpy: Annotated[
            Triple,
            Key(
                'of an `"orientation_kept"`: roll, pitch, yaw in the world', "rad", default="as at the start"
            ),
        ] = None
        tolerance: Finite | None = None

    @classmethod
    def of(cls, given: PathNumbers) -> OrientationKept:
        """Three equations, or a bound on the angle."""
        return cls(given.frame, len(given.lower) == 3)

    @classmethod
    def complete(
        cls, given: Mapping[str, Any], start: pin.SE3, end: Array | None, key: str
    ) -> dict[str, Any]:
        """As at the start."""
        return {"rpy": pin.rpy.matrixToRpy(start.rotation), **given}

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Rotation matrix by columns, and bounds."""
        rotation = pin.rpy.rpyToMatrix(*np.array(given["rpy"], dtype=np.float64))
        return {"rotation": rotation.ravel(order="F"), **_within(given, 3, key)}

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """Angles and tolerance."""
        rotation = given.number("rotation").reshape(3, 3, order="F")
        return {"rpy": pin.rpy.matrixToRpy(rotation), "tolerance": float(given.upper[0])}

    @classmethod
    def check(cls, given: PathNumbers, key: str) -> None:
        """Refuse angles that are none."""
        super().check(given, key)
        if not given.upper[0] < np.pi:
            raise InvalidValue(f"{key}: tolerance", float(given.upper[0]), "an angle below pi [rad]")

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Sines of the rotation that is left, or the cosine of its angle."""
        E = ca.reshape(p["rotation"], 3, 3).T @ at.mechanics.frame_rotation(self.frame, at.q)
        if self.is_exact:
            return vee(E)
        return (ca.trace(E) - 1) / 2

    def target(
        self, given: PathNumbers, name: str, ends: tuple[pin.SE3, pin.SE3], share: float
    ) -> FrameTarget | None:
        """The orientation that it keeps."""
        rotation = given.number("rotation").reshape(3, 3, order="F")
        return FrameTarget(name=name, orientation=pin.Quaternion(rotation).coeffs())

    @property
    def measures(self) -> tuple[Measure, ...]:
        """Sines of three angles, which are zero, or the cosine of one."""
        return (VALUE,) * 3 if self.is_exact else (COSINE,)

    @property
    def rows(self) -> int:
        """Three axes, or one angle."""
        return len(self.measures)

    @classmethod
    def labels(cls, given: PathNumbers) -> tuple[Label, ...]:
        """Angles."""
        return _number(given.name, len(given.lower), cls.unit)


def _within(given: Mapping[str, Any], rows: int, key: str) -> dict[str, Any]:
    """Bounds of `rows` equations, or of one distance or angle."""
    tolerance = given.get("tolerance", 0.0)
    if not tolerance >= 0.0:
        raise InvalidValue(f"{key}: tolerance", tolerance, "a number >= 0")
    if tolerance == 0.0:
        return {"lower": np.zeros(rows), "upper": np.zeros(rows)}
    return {"lower": [-np.inf], "upper": [tolerance]}


def _number(name: str, rows: int, unit: str) -> tuple[Label, ...]:
    names = [name] if rows == 1 else [f"{name}.{'xyz'[i]}" for i in range(rows)]
    return tuple(Label(word, unit) for word in names)
