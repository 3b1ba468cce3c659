"""What all path constraints of a problem are: a term, its bounds, and when they hold."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias

import casadi as ca
import numpy as np

from mbocp._arrays import Array, BoolArray, IntArray
from mbocp._tolerances import BOUND_TOLERANCE
from mbocp.mechanics import JointMechanics
from mbocp.robot import Label, Robot
from mbocp.terms.point import Point
from mbocp.terms.span import NodePlace, Span

SidesInSteps: TypeAlias = tuple[slice | IntArray, Array, Array]


class Structure:
    """The structure of a path constraint, a frozen dataclass: what its function depends on, and no number.

    Attributes
    ----------
    kind : str
    has_velocity : bool
        Whether it depends on the velocity.
    remembers : tuple of str
        Names of what a state remembers for it of the step before a node.
    """

    kind: ClassVar[str]
    has_velocity: ClassVar[bool] = False
    remembers: ClassVar[tuple[str, ...]] = ()

    @property
    def signature(self) -> dict[str, Any]:
        """What its function depends on."""
        return {"term": self.kind, **dataclasses.asdict(self)}  # type: ignore[call-overload]


class MotionAtNodes(NamedTuple):
    """A motion at its nodes 1..N."""

    ts: Array  # [s]
    states: tuple[Array, Array, Array]  # configurations, velocities and controls
    accelerations: Array  # means of the steps that led there
    lams: Array  # forces of constraints
    progress: Mapping[str, Array]  # along paths that are followed, by the names of their constraints


class BoundedTerm:
    """A term with bounds on its values that hold along a span.

    A class says its name, term, span, labels and bounds, as fields or properties. Values are what people
    speak of, in [m] and [rad]; the expression of the term may be their squares or cosines.
    """

    if TYPE_CHECKING:  # fields of some classes, properties of others

        @property
        def name(self) -> str:
            """What it is called."""

        @property
        def span(self) -> Span:
            """When it holds."""

        @property
        def term(self) -> Any:
            """Its structure, with its expression."""

        @property
        def labels(self) -> tuple[Label, ...]:
            """Name and unit of each row."""

        @property
        def lower(self) -> Array:
            """Lower bounds of the values, shape (rows,)."""

        @property
        def upper(self) -> Array:
            """Upper bounds of the values, shape (rows,)."""

    @property
    def rows(self) -> int:
        """Number of its values."""
        return self.term.rows

    @property
    def numbers(self) -> dict[str, Array]:
        """Parameters of the expression by name."""
        return {}

    @property
    def size(self) -> float:
        """Of what its equations are errors from, in units of its own; 0 where bounds say all."""
        return 0.0

    @property
    def inner_bounds(self) -> tuple[Array, Array]:
        """Bounds of the expression, shapes (rows,)."""
        return self.lower, self.upper

    @property
    def is_known_before(self) -> bool:
        """Whether its values follow from a configuration and a velocity."""
        return not self.structure("quaternion").remembers

    def numbers_in(self, rotations: str) -> dict[str, Array]:
        """Parameters with attitudes in these coordinates."""
        return self.numbers

    def structure(self, rotations: str) -> Any:
        """Its term with attitudes in these coordinates."""
        return self.term

    def value(self, h: Array) -> Array:
        """Values of those of the expression, shape (n, rows)."""
        return h

    def slopes(self, values: Array) -> Array:
        """Derivatives of the expression in the values."""
        return np.ones_like(values)

    def values(self, robot: Robot, q: Array, v: Array, at: float | None = None) -> Array:
        """Values at one state, controls zero, at a time [s] if that is known, shape (rows,)."""
        return self.values_along(robot, q[None], v[None], np.zeros((1, robot.nu)))[0]

    def values_along(
        self, robot: Robot, qs: Array, vs: Array, us: Array, accelerations: Array | None = None
    ) -> Array:
        """Values at each of n states, controls and accelerations, shape (n, rows), as solvers see them.

        They are NaN where they ask for accelerations and these are not given.
        """
        u, a = ca.SX.sym("u", robot.nu), ca.SX.sym("a", robot.nv)
        rates = np.full_like(vs, np.nan) if accelerations is None else accelerations
        function = self.function(robot, {"control": u, "acceleration": a}, u, a).map(len(qs))
        return self.value(np.asarray(function(qs.T, vs.T, us.T, rates.T)).T)

    def values_in_motion(self, robot: Robot, nodes: MotionAtNodes) -> Array:
        """Values at the nodes 1..N of a motion, shape (N, rows)."""
        return self.values_along(robot, *nodes.states, nodes.accelerations)

    def function(self, robot: Robot, remembered: Mapping[str, ca.SX], *more: ca.SX) -> ca.Function:
        """The expression as a function of configuration, velocity, and symbols of what is remembered."""
        q, v = ca.SX.sym("q", robot.nq), ca.SX.sym("v", robot.nv)
        numbers = {
            name: ca.SX(ca.DM(np.asarray(value))) for name, value in self.numbers_in("quaternion").items()
        }
        point = Point(JointMechanics(robot), q, v, remembered.get("control"), remembered=remembered)
        return ca.Function("h", [q, v, *more], [ca.densify(self.term.expression(point, numbers))])

    def nodes(self, num_steps: int, dt: float) -> BoolArray:
        """At which of the nodes 1..N each row holds, shape (N, rows)."""
        return np.repeat(self.span.nodes(num_steps, dt)[:, None], self.rows, axis=1)

    def sides_in_steps(
        self, num_steps: int, dt: float, limits: Mapping[str, tuple[Array, Array]] | None, *, is_inner: bool
    ) -> SidesInSteps | None:
        """Steps whose bounds differ, and these bounds, shape (steps, rows) or (rows,); None: there are none.

        Parameters
        ----------
        limits : mapping of str to (ndarray, ndarray), optional
            Of the robot along the steps, by letter, where phases differ in them.
        is_inner : bool
            Whether bounds of the expression are meant, and not of the values.
        """
        return None

    def at_via(self, places: Mapping[str, NodePlace]) -> BoundedTerm:
        """The same with the nodes at which it begins and ends, where via points or phases say it."""
        return self

    def check_frames(self, robot: Robot) -> None:
        """Refuse frames that `robot` does not have; by default they were looked up by name."""

    def refusal(self, values: Array, where: str) -> str:
        """Message about values out of bounds at the start or the goal."""
        above = values > self.upper + BOUND_TOLERANCE
        i = int(np.flatnonzero(above | (values < self.lower - BOUND_TOLERANCE))[0])
        bound, label = self.upper[i] if above[i] else self.lower[i], self.labels[i]
        return (
            f"path {self.name!r}: at the {where} {label.name} is {values[i]:.6g} {label.unit}, "
            f"{'above' if above[i] else 'below'} its bound {bound:.6g}; move the {where}, or the bound"
        )
