"""Bounds on contact forces as path constraints of a problem: with the rows that exert them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.exceptions import ProblemError, suggest
from mbocp.integrators import SCHEMES, schemes_that
from mbocp.problem.contact_force import ContactForce
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.robot import Label, Robot
from mbocp.robot.loops.kinds.constraint import Constraint, perpendiculars
from mbocp.terms.bounded import BoundedTerm, MotionAtNodes, SidesInSteps
from mbocp.terms.contact import ContactTerm
from mbocp.terms.cost import ForceRows
from mbocp.terms.own import OwnTerm
from mbocp.terms.span import NodePlace, Span

_ROOM = 1e-2  # of the weight in a mean step: what arrives at rest has no impulse, and cones no inside there
_GRAVITY = 9.81  # [m/s^2] of the size of forces, also where there is none


@dataclass(frozen=True, eq=False)
class ForceSource:
    """A constraint, and which of its rows have a force.

    Attributes
    ----------
    constraint : Constraint
    rows : tuple of int
        Those of its rows that are not left out as redundant.
    places : tuple of int
        Of these rows among all that have forces: those of the robot, then those of what is held.
    acts : ndarray of bool, shape (N,), optional
        Steps that take time and in which it acts, but those before a parting; None: all.
    hits : ndarray of bool, shape (N,), optional
        Impacts in which it acts; no partings. None: there are none.
    parts : ndarray of bool, shape (N,), optional
        Partings in which it acts, with the force of the step before. None: there are none.
    """

    constraint: Constraint
    rows: tuple[int, ...]
    places: tuple[int, ...]
    acts: BoolArray | None = None
    hits: BoolArray | None = None
    parts: BoolArray | None = None


@dataclass(frozen=True, eq=False)
class ContactBounds(BoundedTerm):
    """Bounds on a contact force among the path constraints, see `mbocp.problem.PathConstraint`.

    Attributes
    ----------
    contact : ContactForce
        What is asked.
    source : ForceSource
        The constraint that exerts it.
    scale : float
        What solvers count forces in [N].
    """

    contact: ContactForce
    source: ForceSource
    scale: float

    is_known_before = False  # as forces are not

    @property
    def name(self) -> str:
        """What it is called."""
        return self.contact.name

    @property
    def span(self) -> Span:
        """When it holds."""
        return self.contact.span

    @cached_property
    def map(self) -> Array:
        """From the forces of its rows to force and torque along the normal and two tangents, shape (6, k).

        Those of the level, z, x and y, on a map.
        """
        normal = self.contact.normal_of(self.source.constraint)
        axes = np.array([normal, *perpendiculars(normal)])
        if self.contact.surface is not None:
            axes = np.eye(3)[[2, 0, 1]]
        whole = self.source.constraint.wrench_map[:, list(self.source.rows)]
        return np.vstack([axes @ whole[:3], axes @ whole[3:]])

    @cached_property
    def term(self) -> ContactTerm:
        """Its structure, with its expression."""
        asked = self.contact
        map_size = () if asked.surface is None else asked.surface.size
        return ContactTerm(
            ground=(self.source.constraint.frame_ids[0], *map_size) if map_size else (),
            of_rows=self.source.places,
            has_cone=asked.friction is not None and asked.facets is None,
            facets=asked.facets or 0,
            has_norm=asked.max is not None,
            has_pressure=asked.pressure is not None,
            has_yaw=asked.yaw_friction is not None,
        )

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        words = [("normal", "N")]
        words += [("cone", "N")] if self.term.has_cone else []
        words += [(f"facet_{k + 1}", "N") for k in range(self.term.facets)]
        words += [("size", "N")] if self.contact.max is not None else []
        sides = ["pressure_1", "pressure_2"] if self.term.has_pressure else []
        sides += ["yaw"] if self.term.has_yaw else []
        words += [(f"{side}_{end}", "N m") for side in sides for end in ("upper", "lower")]
        return tuple(Label(f"{self.name}.{word}", unit) for word, unit in words)

    @cached_property
    def lower(self) -> Array:
        """Of the values, shape (rows,): of ratios zero."""
        found = np.zeros(self.rows)
        found[0] = self.contact.normal_bounds[0]
        if self.term.has_norm:
            found[self._size_row] = -np.inf
        return found

    @cached_property
    def upper(self) -> Array:
        """Of the values, shape (rows,)."""
        found = np.full(self.rows, np.inf)
        found[0] = self.contact.normal_bounds[1]
        if self.contact.max is not None:
            found[self._size_row] = self.contact.max
        return found

    @property
    def hits(self) -> BoolArray | None:
        """Impacts whose impulses are bounded, shape (N,); None where nothing begins or ends along the way."""
        hits = self.source.hits
        return hits if hits is None or self.contact.impulses else np.zeros_like(hits)

    @property
    def steps(self) -> BoolArray | None:
        """Steps whose force or impulse is bounded, shape (N,); None: all."""
        acts, hits, parts = self.source.acts, self.hits, self.source.parts
        return acts if acts is None or hits is None or parts is None else acts | hits | parts

    def bounds_of_impulses(self, *, is_inner: bool) -> tuple[Array, Array]:
        """Bounds of the values in impacts, or of the expression: cones and signs, with room for none.

        What is a number of newtons bounds no impulse. Of a cone the room is that of the expression,
        (mu f_n)^2 - |f_t|^2 >= -room^2, at the least f_n = -room.
        """
        room = np.full(self.rows, _ROOM if is_inner else _ROOM * self.scale)
        if self.term.has_cone:
            mu = float(self.contact.friction or 0.0)
            room[1] *= _ROOM if is_inner else mu + math.hypot(1.0, mu)
        return np.where(self.lower >= 0.0, -room, -np.inf), np.full(self.rows, np.inf)

    @property
    def _size_row(self) -> int:
        return 1 + (1 if self.term.has_cone else self.term.facets)

    @property
    def inner_bounds(self) -> tuple[Array, Array]:
        """Bounds of the expression: by the scale, of the size by its square."""
        lower, upper = self.lower / self.scale, self.upper / self.scale
        if self.term.has_norm:
            upper[self._size_row] **= 2
        return lower, upper

    @cached_property
    def numbers(self) -> dict[str, Array]:
        """Parameters by name."""
        found = {"map": self.map.ravel(order="F") / self.scale}
        if self.contact.friction is not None and self.contact.facets is None:
            found["friction"] = np.array([self.contact.friction])
        if self.contact.facets:
            found["facets"] = self._facets.ravel(order="F")
        if self.contact.pressure is not None:
            found["halves"] = np.array(self.contact.pressure) / 2.0
        if self.contact.yaw_friction is not None:
            found["yaw"] = np.array([self.contact.yaw_friction])
        return found if self.contact.surface is None else found | self.contact.surface._asdict()

    @property
    def _facets(self) -> Array:
        """Of normal force and tangents, shape (facets, 3)."""
        count = self.contact.facets or 0
        turns = 2.0 * np.pi * np.arange(count) / max(count, 1)
        height = (self.contact.friction or 0.0) * math.cos(math.pi / max(count, 1))
        return np.column_stack([np.full(count, height), -np.cos(turns), -np.sin(turns)])

    def at_via(self, places: Mapping[str, NodePlace]) -> ContactBounds:
        """The same between nodes."""
        if not self.span.via_names:
            return self
        span = self.span.at_via(places, self.contact.key)
        return replace(self, contact=replace(self.contact, span=span))

    def nodes(self, num_steps: int, dt: float) -> BoolArray:
        """Those after steps in which it acts."""
        found = super().nodes(num_steps, dt)
        if self.steps is not None:
            found[~self.steps] = False
        return found

    def sides_in_steps(
        self, num_steps: int, dt: float, limits: Mapping[str, tuple[Array, Array]] | None, *, is_inner: bool
    ) -> SidesInSteps | None:
        """Impacts, whose impulses have bounds of their own."""
        if self.hits is None:
            return None
        hits = np.flatnonzero(self.hits & self.span.nodes(num_steps, dt))
        return hits, *self.bounds_of_impulses(is_inner=is_inner)

    def values_in_motion(self, robot: Robot, nodes: MotionAtNodes) -> Array:
        """Those of the forces."""
        if self.contact.surface is None:
            return self.values_of(nodes.lams)
        name = robot.frame_names[self.term.ground[0]]
        places = np.array([robot.frame_placement(name, q).translation for q in nodes.states[0]])
        up = np.column_stack([np.ones(len(places)), -self.contact.surface.at(places)[1]])
        return self.values_of(nodes.lams, up / np.linalg.norm(up, axis=1, keepdims=True))

    def wrenches(self, lams: Array) -> Array:
        """Force and torque along the normal and two tangents, shape (n, 6) [N, N m].

        Parameters
        ----------
        lams : ndarray, shape (n, nc)
            Forces of all rows of the robot's constraints; those of rows left out as redundant are zero.
        """
        return lams[:, list(self.term.of_rows)] @ self.map.T

    def values_of(self, lams: Array, up: Array | None = None) -> Array:
        r"""Values, shape (n, rows) [N, N m]: of a cone :math:`\mu f_n - |f_t|`.

        Parameters
        ----------
        lams : ndarray, shape (n, nc)
            As of `wrenches`.
        up : ndarray, shape (n, 3), optional
            Normal where the frame is on a map, along z, x and y.
        """
        f = self.wrenches(lams)
        if up is not None:
            along = np.einsum("ij,ij->i", up, f[:, :3])
            f = np.column_stack(
                [along, np.linalg.norm(np.cross(up, f[:, :3]), axis=1), np.zeros((len(f), 4))]
            )
        normal, columns = f[:, 0], [f[:, 0]]
        if self.term.has_cone:
            columns.append((self.contact.friction or 0.0) * normal - np.linalg.norm(f[:, 1:3], axis=1))
        columns += list((f[:, :3] @ self._facets.T).T)
        if self.contact.max is not None:
            columns.append(np.linalg.norm(f[:, :3], axis=1))
        if self.contact.pressure is not None:
            for half, torque in zip(np.array(self.contact.pressure) / 2.0, (f[:, 5], f[:, 4]), strict=True):
                columns += [half * normal - torque, half * normal + torque]
        if self.contact.yaw_friction is not None:
            columns += [
                self.contact.yaw_friction * normal - f[:, 3],
                self.contact.yaw_friction * normal + f[:, 3],
            ]
        return np.column_stack(columns)

    def slopes(self, values: Array) -> Array:
        """Derivatives of the expression in the values; of a cone at the value itself."""
        found = np.full_like(values, 1.0 / self.scale)
        if self.term.has_cone:
            reach = 2.0 * (self.contact.friction or 0.0) * values[:, 0]
            found[:, 1] = (reach - values[:, 1]) / self.scale**2
        if self.term.has_norm:
            found[:, self._size_row] = 2.0 * values[:, self._size_row] / self.scale**2
        return found


def force_sources(robot: Robot, table: SwitchTable | None) -> dict[str, ForceSource]:
    """What has forces, by name: the constraints of a robot, and what is held."""
    found, first = {}, 0
    places = {row: k for k, row in enumerate(robot.kept_rows)}
    for constraint in robot.constraints:
        rows = tuple(i for i in range(len(constraint.rows)) if first + i in places)
        own = tuple(places[first + i] for i in rows)
        when = () if table is None else _acts(table, table.own[:, list(own)])
        found[constraint.name] = ForceSource(constraint, rows, own, *when)
        first += len(constraint.rows)
    return found if table is None else found | _holds_by_name(table, robot.nc)


def _holds_by_name(table: SwitchTable, nc: int) -> dict[str, ForceSource]:
    """What is held, by name; rows that are implied in all of its steps have no force."""
    found, first = {}, 0
    for frame in table.held:
        acting = table.pushes[:, first : first + len(frame.rows)]
        rows = tuple(int(i) for i in np.flatnonzero(acting.any(axis=0)))
        own = tuple(nc + first + i for i in rows)
        found[frame.constraint.name] = ForceSource(frame.constraint, rows, own, *_acts(table, acting))
        first += len(frame.rows)
    return found


def _acts(table: SwitchTable, rows: BoolArray) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Steps that take time and in which a constraint of these rows acts, and such impacts and partings.

    A parting stands for the step before it, too: the sum of both forces is bounded, which alone counts.
    """
    acts: BoolArray = np.asarray(rows.any(axis=1))
    parts = acts & table.is_parting
    alone = ~table.is_impact & ~np.append(parts[1:], False)
    return acts & alone, acts & table.is_impact & table.begins_something, parts


def contact_bounds(
    asked: Iterable[ContactForce | ContactBounds], robot: Robot, scheme: str, table: SwitchTable | None
) -> tuple[ContactBounds, ...]:
    """Bounds with what exerts the forces; `table`: when constraints act, where that changes.

    Raises
    ------
    ProblemError
        If there is no such constraint, or it exerts no such force, or forces are no unknowns of the scheme.
    """
    contacts = [one.contact if isinstance(one, ContactBounds) else one for one in asked]
    if not contacts:
        return ()
    check_has_forces(contacts[0].key, scheme)
    sources, found = force_sources(robot, table), []
    for one in contacts:
        source = _source(one, robot, sources)
        found.append(ContactBounds(one, source, _scale(robot, source.constraint.frame_ids)))
    return tuple(found)


def check_has_forces(key: str, scheme: str) -> None:
    """Refuse what speaks of forces of constraints, called `key`, where a step has not one of each.

    Raises
    ------
    ProblemError
    """
    if SCHEMES[scheme].has_forces:
        return
    why = (
        "has several forces of each constraint in a step"
        if SCHEMES[scheme].solves_constraints
        else "projects accelerations, and has no forces of constraints among its unknowns"
    )
    solving = schemes_that(lambda data: data.has_forces)
    raise ProblemError(f'{key}: scheme = "{scheme}" {why}; take one of integrator.scheme = {solving}')


def forces_of_costs(terms: Iterable[OwnTerm], robot: Robot) -> dict[str, str]:
    """Return the constraints whose forces costs of one's own look at, with the key of a cost that does."""
    running = [term for term in terms if term.role == "running"]
    return {name: f"terms: {term.name}" for term in running for name in term.trace(robot).forces}


def force_rows(
    terms: Iterable[OwnTerm], robot: Robot, scheme: str, table: SwitchTable | None
) -> dict[str, ForceRows]:
    """Rows of forces of the constraints that terms of one's own look at, by name.

    Raises
    ------
    ProblemError
        If there is no such constraint, or it joins two joints, or forces are no unknowns of the scheme.
    """
    asked = forces_of_costs(terms, robot)
    sources, found = force_sources(robot, table) if asked else {}, {}
    for name, key in asked.items():
        check_has_forces(key, scheme)
        source = _find_source(name, key, robot, sources)
        whole = source.constraint.wrench_map[:, list(source.rows)]
        found[name] = ForceRows(source.places, tuple(map(tuple, whole.tolist())))
    return found


def _scale(robot: Robot, frame_ids: Iterable[int]) -> float:
    """Return the weight of the lighter of the trees that are held together [N], as a power of two."""
    model, masses = robot.model, []
    of_joint = np.array([inertia.mass for inertia in model.inertias])
    for frame_id in frame_ids:
        path = model.supports[model.frames[frame_id].parentJoint].tolist()
        if len(path) > 1:  # from the world, which bears what it is asked to
            masses.append(float(of_joint[model.subtrees[path[1]].tolist()].sum()))
    mass = min((mass for mass in masses if mass > 0.0), default=float(of_joint.sum()))
    return 2.0 ** round(math.log2(mass * _GRAVITY)) if mass > 0.0 else 1.0


def _find_source(name: str, key: str, robot: Robot, sources: Mapping[str, ForceSource]) -> ForceSource:
    if not sources:
        raise ProblemError(
            f"{key}: robot {robot.name!r} has no constraints that exert forces; hold a frame by a "
            "[[constraint]] in its robot.toml, or by [[robot.constraint]]"
        )
    if name not in sources:
        raise ProblemError(
            f"{key}: robot {robot.name!r} has no constraint {name!r}; {suggest(name, sources)}"
        )
    found = sources[name]
    if not found.constraint.frame_ids:
        raise ProblemError(
            f"{key}: the {found.constraint.kind} {name!r} joins two joints and exerts no "
            "force at a point; name a constraint between frames"
        )
    return found


def _source(asked: ContactForce, robot: Robot, sources: Mapping[str, ForceSource]) -> ForceSource:
    found = _find_source(asked.constraint, asked.key, robot, sources)
    asked.check_kind(found.constraint)
    ground = robot.model.frames[found.constraint.frame_ids[-1]]
    if asked.surface is not None and (
        not found.constraint.fixes_origin
        or ground.parentJoint
        or not np.allclose(ground.placement.rotation, np.eye(3))
    ):
        raise ProblemError(
            f"{asked.key}: heights: hold the frame by a point or a weld, second a frame with the world's axes"
        )
    return found
