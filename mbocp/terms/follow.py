r"""A frame that follows a given path at its own pace.

With c(s) the path, 0 <= s <= 1, and the progress s_n of the frame at node n, a part of the state:

.. math:: s_{n+1} = s_n + e_n w_n, \qquad w_n \ge -\epsilon, \qquad s_0 = 0, \qquad s_N = 1

where w is a control of the programme, the pace in units of the mean one, and e_n is 1 over the number of
steps on the path, 0 in all others. On the path p(q) = c(s); within a tolerance s is that of the nearest
point, as :math:`c'(s) \cdot (p - c(s)) = 0` says, and :math:`|p - c(s)| \le \delta`. An axis of the frame
may keep an angle to the direction c'(s) of the path, as a torch that is dragged or pushed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import casadi as ca
import numpy as np
import pinocchio as pin
from pydantic import Field

from mbocp._arrays import Array, dataclass
from mbocp._keys import Key, Table
from mbocp._text import show
from mbocp._tolerances import BOUND_TOLERANCE
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.lie.groups import vee
from mbocp.robot import FrameTarget, Label, Robot
from mbocp.terms.path_term import COSINE, SQUARE, VALUE, Measure, PathNumbers, PathTerm
from mbocp.terms.point import Point
from mbocp.terms.spline import Curve, curve_through, symbolic_curve
from mbocp.terms.written import Bound, Finite, NonNegative, Triple

_Row = Annotated[list[Finite], Field(min_length=3, max_length=3)]
_Quaternion = Annotated[list[Finite], Field(min_length=4, max_length=4)]
_SHORTEST = 1e-9  # [m] between points of a path
_SHORTEST_SHARE = 1e-12  # of the length of the path
_MAX_POINTS = 2000
_MAX_TURN = 2.0  # [rad] from one orientation to the next: further apart quaternions do not say which way


@dataclass(frozen=True)
class Follow(PathTerm):
    """The frame's origin on a path, or within a distance of it, and its orientation along the path.

    Attributes
    ----------
    num_pieces : int
        Of the path.
    turn : {"", "exact", "within"}
        Whether the orientation is that of the path, or within an angle of it.
    is_exact : bool
        Whether the origin is on the path.
    leans : bool
        Whether an axis of the frame keeps an angle to the direction of the path.
    index : int
        Of its progress, where several frames follow paths.
    """

    num_pieces: int
    turn: str
    is_exact: bool
    leans: bool = False
    index: int = 0

    kind = "follow"
    unit = "m"
    leads = True
    remembers = ("progress",)
    size_of_errors = 0.1  # what is sent may end a thousandth of the path before it at most

    class Keys(Table):
        """Keys."""

        points: Annotated[
            Annotated[list[_Row] | None, Field(max_length=_MAX_POINTS)],
            Key(
                'of a `"follow"`: points, or a file that has them',
                "m",
                default="one of the two",
                takes="list of 3 numbers, or string",
                beside=("file",),
            ),
        ] = None
        file: str | None = None
        orientations: Annotated[
            Annotated[list[_Quaternion] | None, Field(max_length=_MAX_POINTS)],
            Key("unit quaternion xyzw at each point", default="free", takes="list of 4 numbers"),
        ] = None
        closed: Annotated[
            bool | None, Key("whether it goes on from the last point to the first", default="false")
        ] = None
        relative: Annotated[
            bool | None, Key("whether points count from where the frame is at the start", default="false")
        ] = None
        tolerance: Finite | None = None
        orientation_tolerance: Annotated[
            NonNegative | None, Key("how far from these; 0: an equation", "rad", default="0")
        ] = None
        axis: Triple = None
        min: Bound = None
        max: Bound = None

    @classmethod
    def of(cls, given: PathNumbers) -> Follow:
        """With the number of pieces, and what is an equation."""
        pieces = len(given.number("knots")) - 1
        is_exact = bool(given.lower[1] == 0.0)
        leans = "axis" in given.further
        turns = len(given.lower) - (3 if is_exact else 2) - int(leans) - 1
        turn = {0: "", 3: "exact"}.get(turns, "within")
        return cls(given.frame, pieces, turn, is_exact, leans)

    @property
    def sizes(self) -> dict[str, int]:  # type: ignore[override]
        """Knots, coefficients of the pieces, and the length of the path."""
        axis = {"axis": 3} if self.leans else {}
        return {"knots": self.num_pieces + 1, "pieces": 4 * self.size * self.num_pieces, "length": 1, **axis}

    @property
    def size(self) -> int:
        """Coordinates of the path: positions, and quaternions."""
        return 7 if self.turn else 3

    @classmethod
    def complete(
        cls, given: Mapping[str, Any], start: pin.SE3, end: Array | None, key: str
    ) -> dict[str, Any]:
        """With points in the world."""
        found = dict(given)
        if found.pop("relative", False) and "points" in found:
            found["points"] = np.array(found["points"], dtype=np.float64).reshape(-1, 3) + start.translation
        return found

    @classmethod
    def check_goal(cls, given: PathNumbers, end: Array, key: str) -> None:
        """Refuse a goal of the frame that is not where the path ends."""
        there = cls.curve(given).points[-1, :3]
        tolerance = 0.0 if cls.of(given).is_exact else float(given.upper[1])
        if np.linalg.norm(there - end) > tolerance + BOUND_TOLERANCE:
            raise ProblemError(
                f"{key}: the path ends at {show(there.tolist())}, and the goal of its frame is at "
                f"{show(end.tolist())} m; move one of them, or give until"
            )

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """The curve through the points, and bounds."""
        if "points" not in given:
            raise ProblemError(f"{key}: which path? Give points, or a file that has them")
        is_closed = bool(given.get("closed", False))
        points = np.array(given["points"], dtype=np.float64).reshape(-1, 3)
        _check_points(points, is_closed, key)
        turns = given.get("orientations")
        if turns is None and "orientation_tolerance" in given:
            raise ProblemError(f"{key}.orientation_tolerance: of what? Give orientations, or leave it out")
        if turns is not None:
            points = np.hstack([points, _orient_quaternions(turns, len(points), is_closed, key)])
        curve = curve_through(points, is_closed=is_closed)
        lengths = np.linalg.norm(np.diff(curve.points[:, :3], axis=0), axis=1)
        tolerance = _tolerance(given, "tolerance", np.inf, key)
        rows = [(0.0, 0.0)] * 3 if tolerance == 0.0 else [(0.0, 0.0), (-np.inf, tolerance)]
        if turns is not None:
            angle = _tolerance(given, "orientation_tolerance", np.pi, key)
            rows += [(0.0, 0.0)] * 3 if angle == 0.0 else [(-np.inf, angle)]
        leans = "min" in given or "max" in given
        if "axis" in given and not leans:
            raise ProblemError(f"{key}.axis: how far from the direction of the path? Give min or max")
        if leans:
            rows.append((given.get("min", -np.inf), given.get("max", np.inf)))
        lower, upper = np.array([*rows, (0.0, 0.0)]).T
        return {
            **({"axis": given.get("axis", [0.0, 0.0, 1.0])} if leans else {}),
            "knots": curve.knots,
            "pieces": curve.pieces.ravel(),
            "length": np.array([lengths.sum()]),
            "lower": lower,
            "upper": upper,
        }

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """Points and tolerances; a closed path ends as it begins."""
        term, curve = cls.of(given), cls.curve(given)
        is_closed = curve.is_closed
        points = curve.points[:-1] if is_closed else curve.points
        found: dict[str, Any] = {"points": points[:, :3].tolist()}
        if term.turn:
            found["orientations"] = points[:, 3:].tolist()
            found["orientation_tolerance"] = float(given.upper[3 if term.is_exact else 2])
        if term.leans:
            found["axis"] = given.number("axis")
            sides = (("min", given.lower[-2]), ("max", given.upper[-2]))
            found |= {name: float(value) for name, value in sides if np.isfinite(value)}
        return {**found, "closed": is_closed, "tolerance": float(given.upper[0 if term.is_exact else 1])}

    @classmethod
    def check(cls, given: PathNumbers, key: str) -> None:
        """Refuse an axis without a direction, and angles that are none; points are checked before."""
        if cls.of(given).leans:
            if not given.number("axis").any():
                raise InvalidValue(f"{key}: axis", [0.0, 0.0, 0.0], "a direction")
            for name, value in (("min", given.lower[-2]), ("max", given.upper[-2])):
                if np.isfinite(value) and not 0.0 < value < np.pi:
                    raise InvalidValue(f"{key}: {name}", float(value), "an angle between 0 and pi [rad]")

    @staticmethod
    def curve(given: PathNumbers) -> Curve:
        """The path in numbers."""
        knots = np.asarray(given.number("knots"))
        return Curve(knots, np.asarray(given.number("pieces")).reshape(len(knots) - 1, 4, -1))

    def progress(self, given: PathNumbers, robot: Robot, qs: Array) -> Array:
        """How far the frame is along the path at configurations of a motion, shape (n,), from 0 to 1."""
        name = robot.frame_names[self.frame]
        positions = np.array([robot.frame_placement(name, q).translation for q in qs])
        return self.curve(given).nearest(positions)

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """What is left to the path [m], or along it and its square [m^2]; the same of turns; 1 - s."""
        return self._rows_at(at.remembered["progress"][self.index], at, p)

    def within(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """The same at the nearest point to first order: within a step progress is not steady."""
        s = at.remembered["progress"][self.index]
        point, slope = symbolic_curve(s, p["knots"], p["pieces"], self.size)
        away = at.mechanics.frame_position(self.frame, at.q) - point[:3]
        return self._rows_at(s + ca.dot(slope[:3], away) / ca.sumsqr(slope[:3]), at, p)

    def _rows_at(self, s: ca.SX, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        point, slope = symbolic_curve(s, p["knots"], p["pieces"], self.size)
        away = at.mechanics.frame_position(self.frame, at.q) - point[:3]
        rows = [away] if self.is_exact else [ca.dot(slope[:3], away) / p["length"], ca.sumsqr(away)]
        if self.turn:
            E = _rotation(point[3:]).T @ at.mechanics.frame_rotation(self.frame, at.q)
            sines = vee(E)
            rows.append(sines if self.turn == "exact" else (ca.trace(E) - 1) / 2)
        if self.leans:
            axis = at.mechanics.frame_rotation(self.frame, at.q) @ p["axis"]
            rows.append(ca.dot(slope[:3], axis) / ca.sqrt(ca.sumsqr(slope[:3]) * ca.sumsqr(p["axis"])))
        return ca.vertcat(*rows, s - 1)

    @property
    def measures(self) -> tuple[Measure, ...]:
        """Squares of distances and cosines of angles, unless they are zero."""
        turns = {"": (), "exact": (VALUE,) * 3, "within": (COSINE,)}
        leans = (COSINE,) if self.leans else ()
        return (*((VALUE,) * 3 if self.is_exact else (VALUE, SQUARE)), *turns[self.turn], *leans, VALUE)

    @property
    def rows(self) -> int:
        """Of the position, of the orientation, of the lean, and of the end."""
        return len(self.measures)

    @property
    def rows_at_end(self) -> tuple[int, ...]:
        """At the end of its time, and only there, the frame is at the end of the path."""
        return (self.rows - 1,)

    @property
    def rows_with_progress(self) -> tuple[int, ...]:
        """The end, and in a tube the nearest point."""
        return self.rows_at_end if self.is_exact else (0, *self.rows_at_end)

    def draw(self, given: PathNumbers) -> Array | None:
        """The path."""
        return self.curve(given).polyline

    def target(
        self, given: PathNumbers, name: str, ends: tuple[pin.SE3, pin.SE3], share: float
    ) -> FrameTarget | None:
        """At a share of the path."""
        (point,) = self.curve(given).at(np.array([share]))
        return FrameTarget(name=name, position=point[:3], orientation=point[3:] if self.turn else None)

    @classmethod
    def labels(cls, given: PathNumbers) -> tuple[Label, ...]:
        """Coordinates, or along and aside; turns; the end."""
        term, name = cls.of(given), given.name
        words = [f"{name}.{axis}" for axis in "xyz"] if term.is_exact else [f"{name}.along", name]
        turns = {"": [], "exact": [f"{name}.turn_{axis}" for axis in "xyz"], "within": [f"{name}.turn"]}
        leans = [f"{name}.lean"] if term.leans else []
        found = [Label(word, "m") for word in words]
        found += [Label(word, "rad") for word in (*turns[term.turn], *leans)]
        return (*found, Label(f"{name}.end", ""))


def _rotation(quaternion: ca.SX) -> ca.SX:
    """Rotation matrix of a quaternion xyzw of any length."""
    x, y, z, w = ca.vertsplit(quaternion)
    matrix = ca.vertcat(
        ca.horzcat(x * x - y * y - z * z + w * w, 2 * (x * y - z * w), 2 * (x * z + y * w)),
        ca.horzcat(2 * (x * y + z * w), y * y - x * x - z * z + w * w, 2 * (y * z - x * w)),
        ca.horzcat(2 * (x * z - y * w), 2 * (y * z + x * w), z * z - x * x - y * y + w * w),
    )
    return matrix / ca.sumsqr(quaternion)


def _check_points(points: Array, is_closed: bool, key: str) -> None:
    least = 3 if is_closed else 2
    if not least <= len(points) <= _MAX_POINTS:
        raise InvalidValue(f"{key}: points", f"{len(points)} points", f"{least} to {_MAX_POINTS}")
    if not np.isfinite(points).all():
        raise InvalidValue(f"{key}: points", show(points.tolist()), "finite numbers [m]")
    steps = np.linalg.norm(np.diff(np.vstack([points, points[: int(is_closed)]]), axis=0), axis=1)
    if not (steps > max(_SHORTEST, _SHORTEST_SHARE * steps.sum())).all():
        n = int(np.argmin(steps))
        after = (n + 1) % len(points)
        extra = "; a closed path does not repeat its first point" if after == 0 else ""
        raise InvalidValue(f"{key}: points", f"points {n} and {after} at the same place", f"others{extra}")


def _orient_quaternions(given: Any, count: int, is_closed: bool, key: str) -> Array:
    """Unit quaternions, each with the sign that is nearer to the one before."""
    found = np.array(given, dtype=np.float64).reshape(-1, 4)
    if len(found) != count:
        raise InvalidValue(
            f"{key}: orientations", f"{len(found)} quaternions", f"one for each of {count} points"
        )
    norms = np.linalg.norm(found, axis=1)
    if not (np.isfinite(norms).all() and (norms > _SHORTEST).all()):
        raise InvalidValue(f"{key}: orientations", show(found.tolist()), "unit quaternions xyzw")
    found /= norms[:, None]
    for n in range(1, count):
        found[n] *= -1.0 if found[n] @ found[n - 1] < 0.0 else 1.0
    cosines = (found[1:] * found[:-1]).sum(axis=1)
    if is_closed and found[0] @ found[-1] < 0.0:
        raise ProblemError(
            f"{key}: orientations: they turn once about themselves along a closed path; leave closed out, "
            "and repeat the first point and orientation at the end"
        )
    turned = 2.0 * np.arccos(
        np.clip(np.append(cosines, found[0] @ found[-1])[: count - (not is_closed)], -1, 1)
    )
    if turned.max(initial=0.0) > _MAX_TURN:
        n = int(np.argmax(turned))
        raise InvalidValue(
            f"{key}: orientations",
            f"a turn of {turned[n]:.3g} rad after point {n}",
            f"at most {_MAX_TURN:g} rad from one to the next: give points between",
        )
    return found


def _tolerance(given: Mapping[str, Any], name: str, largest: float, key: str) -> float:
    value = float(given.get(name, 0.0))
    if not 0.0 <= value < largest:
        raise InvalidValue(
            f"{key}: {name}", value, "a number >= 0" if np.isinf(largest) else "an angle below pi [rad]"
        )
    return value
