"""Where terms of one's own take part: in the running cost, at the end, and as path constraints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.robot import Label, Robot
from mbocp.terms.bounded import BoundedTerm
from mbocp.terms.cost import ForceRows, RunningTerm, TermNumbers, collect_running_costs
from mbocp.terms.own import OwnTerm, TermFunction
from mbocp.terms.point import Point, Sizes
from mbocp.terms.span import NodePlace, Span

_WEIGHT = "weight"


@dataclass(frozen=True)
class _Part:
    """A term's expression for one robot; all that functions depend on is its digest."""

    digest: str
    term: OwnTerm = field(compare=False)
    traced: TermFunction = field(compare=False)

    @classmethod
    def of(cls, term: OwnTerm, robot: Robot, rotations: str) -> Any:
        """The part of a robot with attitudes in these coordinates."""
        return cls(term.digest(robot), term, term.trace(robot, rotations))

    @property
    def signature(self) -> dict[str, Any]:
        """What its functions depend on."""
        return {"own": self.digest, "role": self.term.role}

    def _own_sizes(self) -> dict[str, int]:
        return {self._key(name): value.size for name, value in self.term.parameters.items()}

    def _own_numbers(self) -> dict[str, Array]:
        return {self._key(name): np.asarray(value) for name, value in self.term.parameters.items()}

    def _value(self, at: Point, p: Mapping[str, ca.SX], wrenches: Sequence[ca.SX] = ()) -> ca.SX:
        return self.traced(at, {name: p[self._key(name)] for name in self.term.parameters}, wrenches)

    def _key(self, name: str) -> str:
        return f"own.{self.term.name}.{name}"


@dataclass(frozen=True)
class OwnRunningCost(_Part, RunningTerm):
    """A cost per second.

    Attributes
    ----------
    forces : tuple of ForceRows
        Of the constraints that it looks at.
    """

    forces: tuple[ForceRows, ...] = ()

    @property
    def signature(self) -> dict[str, Any]:
        """What its functions depend on, rows of forces among that."""
        found = {"own": self.digest, "role": self.term.role}
        return found | ({"forces": self.forces} if self.forces else {})

    @property
    def uses_time(self) -> bool:
        """Whether it depends on the time."""
        return "t" in self.traced.uses

    def parameters(self, sizes: Sizes) -> dict[str, int]:
        """The weight and its own."""
        return {self._key(_WEIGHT): 1, **self._own_sizes()}

    @property
    def weights(self) -> tuple[str, ...]:
        """The weight."""
        return (self._key(_WEIGHT),)

    def numbers(self, given: TermNumbers) -> dict[str, Array]:
        """The weight and its own."""
        return {self._key(_WEIGHT): np.array([self.term.weight]), **self._own_numbers()}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """The weighted value."""
        return p[self._key(_WEIGHT)] * self._value(at, p, [one.wrench(at) for one in self.forces])


@dataclass(frozen=True)
class OwnEnd(_Part):
    """A cost of the last state, or conditions on it."""

    remembers: ClassVar[tuple[str, ...]] = ()

    @property
    def is_cost(self) -> bool:
        """Whether it is a cost."""
        return self.term.role == "terminal"

    @property
    def rows(self) -> int:
        """Number of conditions."""
        return 0 if self.is_cost else self.traced.rows

    def parameters(self) -> dict[str, int]:
        """The weight of a cost, and its own."""
        return {**dict.fromkeys(self.weights, 1), **self._own_sizes()}

    @property
    def weights(self) -> tuple[str, ...]:
        """The weight of a cost."""
        return (self._key(_WEIGHT),) if self.is_cost else ()

    def numbers(self) -> dict[str, Array]:
        """The weight of a cost, and its own."""
        return {**{name: np.array([self.term.weight]) for name in self.weights}, **self._own_numbers()}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """The weighted cost, or the rows."""
        value = self._value(at, p)
        return p[self._key(_WEIGHT)] * value if self.is_cost else value


@dataclass(frozen=True)
class OwnPath(_Part):
    """The structure of a path constraint, as `mbocp.terms.path_term.PathTerm` is that of a file's."""

    has_velocity = True

    @property
    def sizes(self) -> dict[str, int]:
        """Size of each parameter."""
        return {name: value.size for name, value in self.term.parameters.items()}

    @property
    def rows(self) -> int:
        """Number of its values."""
        return self.traced.rows

    @property
    def remembers(self) -> tuple[str, ...]:
        """The control, if it looks at it, be it by way of accelerations."""
        return ("control",) if self.traced.uses & {"u", "a"} else ()

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Its values."""
        return self.traced(at, p)


@dataclass(frozen=True, eq=False)
class OwnPathConstraint(BoundedTerm):
    """A path constraint of a user's own among those of a problem, see `mbocp.problem.PathConstraint`."""

    own: OwnTerm
    robot: Robot

    @property
    def name(self) -> str:
        """What it is called."""
        return self.own.name

    @property
    def span(self) -> Span:
        """When it holds."""
        return self.own.span

    @property
    def labels(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        names = [self.name] if self.rows == 1 else [f"{self.name}.{i}" for i in range(self.rows)]
        return tuple(Label(name, self.own.unit) for name in names)

    @property
    def lower(self) -> Array:
        """Lower bounds, shape (rows,)."""
        return self.own.bounds(self.robot)[0]

    @property
    def upper(self) -> Array:
        """Upper bounds, shape (rows,)."""
        return self.own.bounds(self.robot)[1]

    @property
    def numbers(self) -> dict[str, Array]:
        """Parameters by name."""
        return dict(self.own.parameters)

    @property
    def term(self) -> OwnPath:
        """Its structure, with its expression."""
        return self.structure("quaternion")

    def structure(self, rotations: str) -> OwnPath:
        """The same with attitudes in these coordinates."""
        return OwnPath.of(self.own, self.robot, rotations)

    def at_via(self, places: Mapping[str, NodePlace]) -> OwnPathConstraint:
        """The same between nodes."""
        if not self.span.via_names:
            return self
        span = self.span.at_via(places, f"path {self.name!r}")
        return replace(self, own=replace(self.own, span=span))

    def check_frames(self, robot: Robot) -> None:
        """Refuse what does not fit a robot."""
        self.own.check(robot)

    def values_along(
        self, robot: Robot, qs: Array, vs: Array, us: Array, accelerations: Array | None = None
    ) -> Array:
        """Values at each of n states and controls, shape (n, rows)."""
        mechanics = ForwardMechanics(robot)
        q, v, u = ca.SX.sym("q", robot.nq), ca.SX.sym("v", robot.nv), ca.SX.sym("u", robot.nu)
        at = Point(mechanics, q, v, u, acceleration=lambda: mechanics.speed_rate(q, v, u, ca.SX(0)))
        numbers = {name: ca.SX(ca.DM(np.asarray(value))) for name, value in self.own.parameters.items()}
        h = ca.densify(self.own.trace(robot)(at, numbers))
        return np.asarray(ca.Function("h", [q, v, u], [h]).map(len(qs))(qs.T, vs.T, us.T)).T


def collect_running_terms(given: TermNumbers) -> tuple[RunningTerm, ...]:
    """All terms of the running cost, the user's own last, in the order in which they are added."""
    rotations = _rotations(given)
    parts = (OwnRunningCost.of(t, given.robot, rotations) for t in given.own if t.role == "running")
    own = (replace(one, forces=tuple(given.forces[name] for name in one.traced.forces)) for one in parts)
    return (*collect_running_costs(given), *own)


def own_ends(given: TermNumbers) -> tuple[OwnEnd, ...]:
    """Own terms of the end, costs first."""
    rotations, roles = _rotations(given), ("terminal", "end")
    return tuple(OwnEnd.of(t, given.robot, rotations) for r in roles for t in given.own if t.role == r)


def _rotations(given: TermNumbers) -> str:
    return "dcm" if any(part.at_matrix >= 0 for part in given.joints.parts) else "quaternion"
