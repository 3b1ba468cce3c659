"""When which constraints act, row by row and step by step, and what holds where they are taken on."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass, frozen_array, null_space
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.mechanics.held_frames import HeldFrame, compute_held_jacobians, compute_held_residuals, label_held
from mbocp.problem.timeline.hold import Hold, Schedule
from mbocp.robot import Label, Robot
from mbocp.terms.bounded import BoundedTerm
from mbocp.terms.contact import ContactConditionTerm
from mbocp.terms.span import Span


@dataclass(frozen=True, eq=False)
class Begin:
    """A constraint is taken on.

    Attributes
    ----------
    step : int
        The first in which it acts.
    frame : HeldFrame
    rows : tuple of int
        Those of its rows that act.
    """

    step: int
    frame: HeldFrame
    rows: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class SwitchTable:
    """What acts in which step.

    Attributes
    ----------
    robot : Robot
    schedule : Schedule
        Holds and releases of which it is made, and the impacts.
    held : tuple of HeldFrame
        In the order of the holds.
    own : ndarray of bool, shape (N, nc)
        Rows of the robot's own constraints, those that are kept.
    rows : ndarray of bool, shape (N, rows)
        Rows of the held frames; of rows that others imply the first are taken.
    is_impact : ndarray of bool, shape (N,)
    begins : tuple of Begin
        Where spans begin after the start, and where released constraints are taken on again.
    """

    robot: Robot
    schedule: Schedule
    held: tuple[HeldFrame, ...]
    own: BoolArray
    rows: BoolArray
    is_impact: BoolArray
    begins: tuple[Begin, ...]

    @property
    def has_releases(self) -> bool:
        """Whether constraints of the robot are let go."""
        return not bool(self.own.all())

    @property
    def free_feet(self) -> tuple[Hold, ...]:
        """Feet whose forces are found in all steps."""
        return tuple(hold for hold in self.schedule.holds if hold.free is not None)

    @cached_property
    def pushes(self) -> BoolArray:
        """Rows of the held frames with a force, shape (N, rows): those that act, and of free feet."""
        pairs = zip(self.schedule.holds, self.held, strict=True)
        free = [hold.free is not None for hold, frame in pairs for _ in frame.rows]
        return self.rows | np.array(free, dtype=np.bool_)

    @property
    def labels(self) -> tuple[Label, ...]:
        """Name and unit of each row of the held frames."""
        return label_held(self.held)

    @property
    def coincides(self) -> BoolArray:
        """Which rows of the held frames say where these are, and not that they stay, shape (rows,)."""
        return np.array([not frame.is_anchored for frame in self.held for _ in frame.rows], dtype=np.bool_)

    @cached_property
    def anchors(self) -> Array:
        """The node from which each row is held, by step, shape (N, rows); -1 where it does not act."""
        found = np.full(self.rows.shape, -1)
        for step, acts in enumerate(self.rows):
            before = found[step - 1] if step else np.full(len(acts), -1)
            found[step] = np.where(acts, np.where(before < 0, step, before), -1)
        return found

    @cached_property
    def begins_something(self) -> BoolArray:
        """Steps in which a constraint is taken on, shape (N,)."""
        return np.isin(np.arange(len(self.is_impact)), [begin.step for begin in self.begins])

    @cached_property
    def is_parting(self) -> BoolArray:
        """Steps that are partings and follow one that takes time, shape (N,)."""
        follows = np.append(False, ~self.is_impact[:-1])
        return np.asarray(self.is_impact & ~self.begins_something & follows)

    @property
    def last_timed_step(self) -> int:
        """The last step that takes time."""
        return int(np.flatnonzero(~self.is_impact)[-1])

    def jacobians(self, qs: Array) -> Array:
        """Derivatives of the rows of the held frames at n configurations, shape (n, rows, nv)."""
        if not self.held:
            return np.zeros((len(qs), 0, self.robot.nv))
        return compute_held_jacobians(self.robot, self.held, qs)

    def residuals(self, qs: Array, anchors: Array) -> Array:
        """Rows of the held frames at n configurations from n anchors, shape (n, rows)."""
        if not self.held:
            return np.zeros((len(qs), 0))
        return compute_held_residuals(self.robot, self.held, qs, anchors)

    def at_end(self, q: Array, *, of_rates: bool) -> Array:
        """Derivatives of what ties the end, shape (any, nv).

        An impact at the end ties velocities; positions are tied by what acted before it. A frame that is held
        where it was when its hold began ties them only as far as its place then was tied.
        """
        if of_rates:
            return self.in_step(q, len(self.rows) - 1)
        return self._tie_rows(q, self.last_timed_step)

    def _tie_rows(self, q: Array, step: int) -> Array:
        """Derivatives of what ties the configuration after a step, the start being given, shape (any, nv)."""
        at = np.where(self.rows[step], self.anchors[step], -1)
        found = [self.derivatives(q, self.own[step], self.rows[step] & ((at <= 0) | self.coincides))]
        for anchor in np.unique(at[(at > 0) & ~self.coincides]):
            mine = self.derivatives(q, np.zeros_like(self.own[step]), (at == anchor) & ~self.coincides)
            before = self._tie_rows(q, anchor - 1)
            # combinations of these rows that those which tie the place do not let move there
            loose = null_space(before, RANK_TOLERANCE)
            found.append(null_space((mine @ loose).T, RANK_TOLERANCE).T @ mine)
        return np.vstack(found)

    def rows_at_start(self, *, of_rates: bool) -> tuple[BoolArray, BoolArray]:
        """Which rows a start has to keep, of the robot's constraints (nc,) and of the held frames (rows,).

        Before an impact velocities are whatever they are, and what is held where it is, is there.
        """
        if not of_rates:
            return self.own[0], self.rows[0] & self.coincides
        takes_time = not self.is_impact[0]
        return self.own[0] & takes_time, self.rows[0] & takes_time

    def at_start(self, q: Array, *, of_rates: bool) -> Array:
        """Derivatives of the rows that a start has to keep, shape (any, nv)."""
        return self.derivatives(q, *self.rows_at_start(of_rates=of_rates))

    def in_step(self, q: Array, step: int) -> Array:
        """Derivatives of all rows that act in a step, at a configuration, shape (any, nv)."""
        return self.derivatives(q, self.own[step], self.rows[step])

    def derivatives(self, q: Array, own: BoolArray, rows: BoolArray) -> Array:
        """Derivatives of some rows of the robot's constraints and of the held frames, shape (any, nv)."""
        of_robot = self.robot.constraint_jacobian(q)[own]
        return np.vstack([of_robot, self.jacobians(q[None])[0][rows]])

    def along(self, qs: Array, own: Array) -> Array:
        """Derivatives of all rows, zero where they have no force, shape (N, nc + rows, nv).

        Parameters
        ----------
        qs : ndarray, shape (N, nq)
            A configuration of each step.
        own : ndarray, shape (N, nc, nv)
            Derivatives of the robot's own rows there.
        """
        acts = np.hstack([self.own, self.pushes])
        return np.concatenate([own, self.jacobians(qs)], axis=1) * acts[:, :, None]


@dataclass(frozen=True, eq=False)
class ContactCondition(BoundedTerm):
    """What holds at the node where a constraint is taken on, among the path constraints of a problem.

    Attributes
    ----------
    begin : Begin
    term : ContactConditionTerm
    """

    begin: Begin
    term: ContactConditionTerm

    @property
    def name(self) -> str:
        """What it is called."""
        return f"{self.begin.frame.constraint.name} taken on at node {self.node}"

    @property
    def node(self) -> int:
        """Where it holds."""
        return self.begin.step

    @property
    def span(self) -> Span:
        """When it holds."""
        return Span.at_node(self.node)

    @property
    def labels(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        labels = [self.begin.frame.rows[row] for row in self.term.kept]
        places = [Label(f"{x.name} at node {self.node}", x.unit) for x in labels if self.term.has_place]
        rates = [Label(f"rate of {x.name} at node {self.node}", f"{x.unit}/s") for x in labels]
        return (*places, *(rates if self.term.has_rate else ()))

    @property
    def lower(self) -> Array:
        """Lower bounds, shape (rows,): zero."""
        return frozen_array(np.zeros(self.rows))

    @property
    def upper(self) -> Array:
        """Upper bounds, shape (rows,): zero."""
        return self.lower


def contact_conditions(table: SwitchTable | None) -> tuple[ContactCondition, ...]:
    """Return conditions where spans begin: frames that are to coincide do; without an impact none moves."""
    if table is None:
        return ()
    found = []
    for begin in table.begins:
        has_place, has_rate = not begin.frame.is_anchored, not bool(table.is_impact[begin.step])
        if has_place or has_rate:
            term = ContactConditionTerm(begin.frame, begin.rows, has_place, has_rate)
            found.append(ContactCondition(begin, term))
    return tuple(found)


def rows_by_frame(held: Sequence[HeldFrame]) -> dict[str, list[list[int]]]:
    """Return rows that say the same under other names, row by row of each frame that there is."""
    found: dict[str, list[list[int]]] = {}
    for frame, where in zip(held, rows_of_frames(held), strict=True):
        rows = found.setdefault(repr(frame.signature), [[] for _ in frame.rows])
        for row, place in zip(rows, range(where.start, where.stop), strict=True):
            row.append(place)
    return found


def rows_of_frames(held: Sequence[HeldFrame]) -> list[slice]:
    """Return which rows are those of each frame."""
    ends = np.cumsum([0, *(len(frame.rows) for frame in held)])
    return [slice(int(first), int(last)) for first, last in pairwise(ends)]
