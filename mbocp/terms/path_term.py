"""What a path constraint is.

A class is a kind of constraint on a frame: its keys in `[[path]]`, its expression, names and units of its
rows. An instance is the structure of a constraint: all that its function depends on, and no number.

Defining a class adds it to `PATH_TERMS`; schema, parameters, the text of a problem, labels and the
documentation follow from there. `mbocp.problem.PathConstraint` holds the numbers.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, Protocol

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp._keys import Table
from mbocp._text import show
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.robot import FrameTarget, Label, Robot
from mbocp.terms.bounded import Structure
from mbocp.terms.point import Point

PATH_TERMS: dict[str, type[PathTerm]] = {}  # by kind, in the order in which they are documented


class Measure(NamedTuple):
    """What an expression is of the value that people speak of: that itself, or what is smooth everywhere."""

    inner: Callable[[float, float], tuple[float, float]]  # bounds of the expression from those of the value
    value: Callable[[Array], Array]  # from that of the expression
    slope: Callable[[Array], Array]  # of the expression, from the value


def _of_squares(lower: float, upper: float) -> tuple[float, float]:
    return float(np.sign(lower) * lower**2), float(np.sign(upper) * upper**2)


def _of_cosines(lower: float, upper: float) -> tuple[float, float]:
    least = float(np.cos(upper)) if np.isfinite(upper) else -np.inf
    return least, float(np.cos(lower)) if np.isfinite(lower) else np.inf


VALUE = Measure(lambda lower, upper: (lower, upper), lambda h: h, np.ones_like)
SQUARE = Measure(_of_squares, np.sqrt, lambda value: 2.0 * value)
COSINE = Measure(_of_cosines, lambda h: np.arccos(np.clip(h, -1.0, 1.0)), lambda value: -np.sin(value))


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

    @property
    def further(self) -> Mapping[str, Any]:
        """Parameters of its kind that are no fields, by name."""

    def number(self, key: str) -> Array:
        """Value of one of its parameters."""


@dataclass(frozen=True)
class PathTerm(Structure, ABC):
    """A constraint on a frame, see the module.

    Attributes
    ----------
    unit : str
        Of its bounds.
    sizes : mapping
        Size of each parameter.
    defaults : mapping
        Keys that are its parameters as they are written, and what they are where nothing is written.
    measure : Measure
        What its expression is of the value, where that is the same in all rows.
    leads : bool
        Whether it says where the frame is all the way, so that a guess can follow.
    of_joint : bool
        Whether it is about a joint with one angle, by whose frame that is named.
    of_motor : bool
        Whether it is about the motor of that joint.
    of_robot : bool
        Whether it is about all of the robot, and no frame.
    size_of_errors : float
        Of what its equations are errors from; 0 where bounds say all.
    frame : int
        Index of the frame.
    """

    frame: int

    unit: ClassVar[str]
    sizes: ClassVar[Mapping[str, int]] = {}
    defaults: ClassVar[Mapping[str, Any]] = {}
    measure: ClassVar[Measure] = VALUE
    leads: ClassVar[bool] = False
    of_joint: ClassVar[bool] = False
    of_motor: ClassVar[bool] = False
    of_robot: ClassVar[bool] = False
    size_of_errors: ClassVar[float] = 0.0
    Keys: ClassVar[type[Table]]

    def __init_subclass__(cls) -> None:
        if "kind" in cls.__dict__:
            PATH_TERMS[cls.kind] = cls

    @classmethod
    def of(cls, given: PathNumbers) -> PathTerm:
        """The structure of a constraint."""
        return cls(given.frame)

    @classmethod
    def complete(
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
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Arguments of `PathConstraint` from the keys that are written, beside name, kind and frame."""
        numbers = {name: given.get(name, default) for name, default in cls.defaults.items()}
        return {**numbers, **one_bound(given, key)}

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """Keys that read back as the same, beside name, kind and frame."""
        return {**{name: given.number(name) for name in cls.defaults}, **finite_bounds(given)}

    @abstractmethod
    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Its function at a point, smooth wherever a motion may be, with its parameters by name."""

    def within(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Its function within a step, where what is remembered is that of steady progress."""
        return self.expression(at, p)

    @property
    def rows(self) -> int:
        """Number of inequalities."""
        return 1

    @classmethod
    def check(cls, given: PathNumbers, key: str) -> None:
        """Refuse numbers that the kind has no use for."""
        for name in cls.sizes:
            if not np.isfinite(given.number(name)).all():
                raise InvalidValue(f"{key}: {name}", show(given.number(name).tolist()), "finite numbers")

    @property
    def rows_at_end(self) -> tuple[int, ...]:
        """Rows that hold at the last of its nodes alone."""
        return ()

    @property
    def rows_with_progress(self) -> tuple[int, ...]:
        """Rows that the progress along a path fulfils, whatever the configuration is."""
        return ()

    def draw(self, given: PathNumbers) -> Array | None:
        """Points of the line that the frame is on, shape (k, 3) [m], where there is one."""
        return None

    def target(
        self, given: PathNumbers, name: str, ends: tuple[pin.SE3, pin.SE3], share: float
    ) -> FrameTarget | None:
        """Where the frame `name` is after a share of the way, where the constraint says so.

        Parameters
        ----------
        ends : tuple of pinocchio.SE3
            Placements of the frame at the start and at the goal.
        """
        return None

    @classmethod
    def labels(cls, given: PathNumbers) -> tuple[Label, ...]:
        """Name and unit of each row."""
        return (Label(given.name, cls.unit),)

    @property
    def measures(self) -> tuple[Measure, ...]:
        """What the expression of each row is of the value that people speak of."""
        return (self.measure,) * self.rows

    def inner(self, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        """Bounds of the expression, from those of the value that people speak of."""
        rows = zip(self.measures, *bounds, strict=True)
        lower, upper = np.array([measure.inner(low, high) for measure, low, high in rows]).T
        return lower, upper

    def value(self, h: Array) -> Array:
        """The value that people speak of, from that of the expression."""
        return np.stack([measure.value(h[..., i]) for i, measure in enumerate(self.measures)], axis=-1)

    def slope(self, value: Array) -> Array:
        """Derivative of the expression in the value."""
        return np.stack([measure.slope(value[..., i]) for i, measure in enumerate(self.measures)], axis=-1)


def one_bound(given: Mapping[str, Any], key: str) -> dict[str, Any]:
    """Bounds of one row from `min` and `max`."""
    if "min" not in given and "max" not in given:
        raise ProblemError(f"{key}: bounds nothing; give min or max")
    return {"lower": [given.get("min", -np.inf)], "upper": [given.get("max", np.inf)]}


def finite_bounds(given: PathNumbers) -> dict[str, float]:
    """`min` and `max` of one row, where there are any."""
    sides = (("min", given.lower[0]), ("max", given.upper[0]))
    return {key: value for key, value in sides if np.isfinite(value)}
