"""Kinds of path constraints whose limits fall with the speed of a joint, and accelerations among them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import casadi as ca
import numpy as np
from pydantic import Field

from mbocp._arrays import Array, dataclass
from mbocp._keys import Key, Table
from mbocp._text import show
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.robot import Label, Robot
from mbocp.terms.path_term import PathNumbers, PathTerm
from mbocp.terms.point import Point
from mbocp.terms.written import Finite

_Row = Annotated[list[Finite], Field(min_length=2, max_length=2)]
_MAX_ROWS = 50
Curve = Annotated[list[_Row] | None, Field(max_length=_MAX_ROWS)]
CURVE_UNIT = "rad/s; N m, rad/s^2"
_ROUND_OFF = 1e-9  # relative, by which slopes of a table may be less steep than the one before


@dataclass(frozen=True)
class OverSpeed(PathTerm):
    r"""What falls with the speed v of a joint: rows x + k v of something x, one for each line of a table.

    Where a table has several lines all hold at once, so that the values of the table fall ever faster.

    Attributes
    ----------
    points : int
        Rows of the table.
    excess : str
        What leaves its limit, in a word.
    values : str
        What messages call the values of the table.
    """

    points: int

    has_velocity = True
    of_joint = True
    excess: ClassVar[str]
    values: ClassVar[str]

    @classmethod
    def of(cls, given: PathNumbers) -> OverSpeed:
        """With so many rows of its table."""
        return cls(given.frame, len(given.further.get("speeds", (0.0, 0.0))))

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """The table."""
        return {"curve": np.column_stack([given.number("speeds"), given.number("values")]).tolist()}

    @classmethod
    def check(cls, given: PathNumbers, key: str) -> None:
        """Refuse what is no such table."""
        curve = np.column_stack([given.number("speeds"), given.number("values")])
        check_curve(curve, f"{key}: curve", cls.values)

    @classmethod
    def slopes(cls, given: PathNumbers) -> Array:
        """The k of each row."""
        return slopes_of(given.number("speeds"), given.number("values"))

    @property
    def sizes(self) -> dict[str, int]:  # type: ignore[override]
        """Of the two columns of the table."""
        return {"speeds": self.points, "values": self.points}

    @property
    def rows(self) -> int:
        """One for each line."""
        return self.points - 1

    @classmethod
    def labels(cls, given: PathNumbers) -> tuple[Label, ...]:
        """The number of the line behind the name, where there are several."""
        lines = len(given.number("speeds")) - 1
        names = [given.name] if lines == 1 else [f"{given.name}.{n}" for n in range(1, lines + 1)]
        return tuple(Label(name, cls.unit) for name in names)


@dataclass(frozen=True)
class AccelerationOverSpeed(OverSpeed):
    r"""Acceleration of a joint that falls with its speed, where it speeds up and where it slows down.

    .. math:: |a| + k |v| \le a_0

    It holds for the mean acceleration of each step with the velocity at its end.

    Attributes
    ----------
    has_plateau : bool
        Whether the first line does not fall, so that its rows for both ways are one.
    """

    has_plateau: bool

    kind = "acceleration"
    unit = "rad/s^2"
    remembers = ("acceleration",)
    excess = "value"
    values = "accelerations"

    class Keys(Table):
        """Keys."""

        curve: Annotated[
            Curve,
            Key(
                'of an `"acceleration"` of a joint, `frame`: rows [speed, acceleration]',
                CURVE_UNIT,
                takes="list of pairs",
            ),
        ] = None

    @classmethod
    def of(cls, given: PathNumbers) -> AccelerationOverSpeed:
        """With so many rows of its table."""
        values = given.further.get("values", (0.0, 0.0))
        return cls(given.frame, len(values), bool(values[0] == values[1]))

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Bounds, of the sizes of the accelerations that lines have at rest, and numbers."""
        if "curve" not in given:
            raise ProblemError(f"{key}.curve: this key is missing")
        speeds, values = check_curve(np.array(given["curve"]).reshape(-1, 2), f"{key}.curve", cls.values)
        at_rest = values_at_rest(speeds, values)
        at_rest = np.append(at_rest, at_rest[int(values[0] == values[1]) :])
        return {"lower": -at_rest, "upper": at_rest, "speeds": speeds, "values": values}

    @property
    def rows(self) -> int:
        """Of each line one for speeding up and one for slowing down."""
        return 2 * (self.points - 1) - self.has_plateau

    @classmethod
    def slopes(cls, given: PathNumbers) -> Array:
        """The k of each row."""
        slopes = super().slopes(given)
        return np.append(slopes, -slopes[cls.of(given).has_plateau :])

    @classmethod
    def labels(cls, given: PathNumbers) -> tuple[Label, ...]:
        """Which way, and the number of the line."""
        names = [label.name for label in super().labels(given)]
        flat, falling = names[: cls.of(given).has_plateau], names[cls.of(given).has_plateau :]
        ways = [f"{name} {way}" for way in ("speeding up", "slowing down") for name in falling]
        return tuple(Label(name, cls.unit) for name in (*flat, *ways))

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Acceleration that each line would have at rest [rad/s^2]."""
        place = place_of(self.frame, at.mechanics.robot)
        change = slopes_of(p["speeds"], p["values"]) * at.joint_velocity()[place]
        return at.remembered["acceleration"][place] + ca.vertcat(change, -change[int(self.has_plateau) :])


def place_of(frame: int, robot: Robot) -> int:
    """Return where a joint, by its frame, has its velocity."""
    return int(robot.model.joints[robot.model.frames[frame].parentJoint].idx_v)


def read_falling_lines(curve: Array, key: str, what: str) -> Array:
    """Rows of a table over speeds, shape (n, 2), without the flat part that a limit along the motion is.

    The first line goes on to rest; no row is left of a table that is flat.

    Parameters
    ----------
    curve : ndarray, shape (m, 2)
        Speeds and values.
    key : str
        What messages call the table.
    what : str
        What messages call the values.

    Raises
    ------
    InvalidValue
        If it is no such table.
    """
    speeds, values = check_curve(curve, key, what)
    first = int(np.searchsorted(-values, -values[0], side="right")) - 1
    if first + 1 == len(speeds):
        return np.zeros((0, 2))
    left = np.array(curve[first:], dtype=np.float64)
    left[0] = 0.0, values_at_rest(speeds, values)[first]
    return left


def slopes_of(speeds: Any, values: Any) -> Any:
    """Return by how much values fall with the speed in each line, by [rad/s]."""
    return (values[:-1] - values[1:]) / (speeds[1:] - speeds[:-1])


def values_at_rest(speeds: Array, values: Array) -> Array:
    """Return what each line, gone on with, has at rest."""
    return values[:-1] + slopes_of(speeds, values) * speeds[:-1]


def check_curve(curve: Array, key: str, what: str) -> tuple[Array, Array]:
    """Return speeds and values of a table; messages call these `what`."""
    speeds, values = curve.T
    if len(curve) < 2 or not np.isfinite(curve).all():
        expected = f"two or more rows [speed, {what.removesuffix('s')}] of finite numbers"
        raise InvalidValue(key, show(curve.tolist()), expected)
    if speeds[0] != 0.0 or not (np.diff(speeds) > 0.0).all():
        raise InvalidValue(key, f"speeds {show(speeds.tolist())}", "speeds that rise from 0 on")
    if not (values[0] > 0.0 and (values >= 0.0).all() and (np.diff(values) <= 0.0).all()):
        raise InvalidValue(
            key, f"{what} {show(values.tolist())}", "one above 0 at rest, and none that rises or is below 0"
        )
    slopes = slopes_of(speeds, values)
    flatter = np.flatnonzero(np.diff(slopes) < -_ROUND_OFF * slopes.max())
    if flatter.size:
        raise InvalidValue(
            key,
            f"{what} that fall less steeply after {speeds[flatter[0] + 1]:g}",
            f"{what} that fall ever faster: a limit that is not concave is not the least of several lines; "
            "leave rows out so that it is, on the safe side",
        )
    return speeds, values
