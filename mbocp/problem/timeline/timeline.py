"""The time of a problem in its normal form: phases, and junctions at which something happens.

However it is said, it is this: a plain problem has one phase; a via point is a junction with conditions, and
one of free time ends a phase whose length is found; what is taken on is a junction with conditions, too, and
an impact one that leaps. `mbocp.problem.resolve` makes it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import TypeAlias

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.exceptions import ProblemError
from mbocp.problem.timeline.free_times import find_timed_nodes, phases_between
from mbocp.problem.timeline.hold import Schedule
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.sequence import Horizon, are_alike, places_of
from mbocp.problem.timeline.switches import ContactCondition, SwitchTable
from mbocp.problem.timeline.via import ViaConstraint
from mbocp.terms.span import NodePlace

Condition: TypeAlias = ViaConstraint | ContactCondition
ANY_TIME = 0.0, math.inf


@dataclass(frozen=True, eq=False)
class Junction:
    """A node at which something happens.

    Attributes
    ----------
    node : int
    conditions : tuple of ViaConstraint and ContactCondition
        What holds there.
    leaps : bool
        Whether the step from it takes no time, and velocities leap: an impact, or a parting.
    earliest, latest : float
        Bounds of its time, where that is found [s].
    """

    node: int
    conditions: tuple[Condition, ...] = ()
    leaps: bool = False
    earliest: float = 0.0
    latest: float = math.inf

    @property
    def waypoints(self) -> tuple[ViaConstraint, ...]:
        """The via point among its conditions, if there is one."""
        return tuple(one for one in self.conditions if isinstance(one, ViaConstraint))


@dataclass(frozen=True, eq=False)
class Timeline:
    """Phases one after the other, and junctions in the order of their nodes.

    Attributes
    ----------
    duration : float
        T [s]; a guess of it where `duration_range` says that it is free.
    duration_range : tuple of float or None
        Least and greatest T [s].
    phases : tuple of Phase
        At least one. Where lengths of steps are found, all steps of a phase have the same.
    junctions : tuple of Junction
        Nodes with conditions, impacts, and ends of phases; that of the last phase comes last.
    given_lengths : ndarray, shape (N,), or None
        Lengths of the steps [s], where they are said one by one.
    switches : SwitchTable or None
        Which constraints act in which step, where that changes.
    """

    duration: float
    duration_range: tuple[float, float] | None
    phases: tuple[Phase, ...]
    junctions: tuple[Junction, ...]
    given_lengths: Array | None = None
    switches: SwitchTable | None = None

    @property
    def num_steps(self) -> int:
        """N, impacts included."""
        return self.phases[-1].last

    @property
    def num_timed_steps(self) -> int:
        """Number of the steps that take time: all but impacts."""
        return self.num_steps - len(self.impacts)

    @property
    def dt(self) -> float:
        """Mean length of a step [s]; the guess of it where the duration is free."""
        return self.duration / self.num_timed_steps

    @cached_property
    def impacts(self) -> tuple[int, ...]:
        """Steps of no duration, counted from 0, in which velocities leap."""
        return tuple(junction.node for junction in self.junctions if junction.leaps)

    @cached_property
    def is_impact(self) -> BoolArray:
        """Which steps take no time, shape (N,)."""
        found = np.zeros(self.num_steps, dtype=np.bool_)
        found[list(self.impacts)] = True
        found.setflags(write=False)
        return found

    @property
    def schedule(self) -> Schedule:
        """Holds, releases and impacts."""
        return Schedule() if self.switches is None else self.switches.schedule

    @cached_property
    def waypoints(self) -> tuple[ViaConstraint, ...]:
        """Via points as path constraints, in the order of their nodes."""
        return tuple(point for junction in self.junctions for point in junction.waypoints)

    @property
    def named_phases(self) -> tuple[Phase, ...]:
        """The phases that a table says; empty where none does."""
        return tuple(phase for phase in self.phases if phase.name)

    @property
    def places(self) -> dict[str, NodePlace]:
        """Nodes of via points and phases by name.

        Raises
        ------
        ProblemError
            If one of each have the same name.
        """
        phases = places_of(self.phases)
        for point in self.waypoints:
            if point.name in phases:
                raise ProblemError(f"via {point.name!r}: a phase has this name, too; give each its own")
        return {**{point.name: NodePlace(point.node, point.node) for point in self.waypoints}, **phases}

    @property
    def has_free_lengths(self) -> bool:
        """Whether lengths of steps are found with the motion: the duration, or times on the way."""
        return any(phase.is_free for phase in self.phases)

    @property
    def free_phases(self) -> tuple[Phase, ...]:
        """The phases where lengths are found; empty where all are given."""
        return self.phases if self.has_free_lengths else ()

    @property
    def has_free_times(self) -> bool:
        """Whether times on the way are found with the motion."""
        return self.has_free_lengths and len(self.phases) > 1

    @property
    def is_even(self) -> bool:
        """Whether all steps that take time are as long as each other."""
        return self.given_lengths is None and (len(self.phases) == 1 or are_alike(self.phases))

    @property
    def has_unequal_lengths(self) -> bool:
        """Whether lengths of steps are given, and differ."""
        return not (self.is_even or self.has_free_lengths)

    @property
    def num_lengths(self) -> int:
        """Number of lengths of steps that are found, or differ; 0 where all are given and the same."""
        return 0 if self.is_even and not self.has_free_lengths else len(self.phases)

    def lengths(self) -> Array:
        """Lengths of the steps [s], or their guess, shape (N,)."""
        if self.given_lengths is not None:
            return np.array(self.given_lengths)
        dts = [self.dt if self.is_even else phase.dt for phase in self.phases]
        lengths = np.repeat(dts, [phase.last - phase.first for phase in self.phases])
        lengths[list(self.impacts)] = 0.0
        return lengths

    def times(self) -> Array:
        """Times of the nodes [s], or their guess, shape (N + 1,)."""
        if self.is_even and not self.impacts:
            return np.arange(self.num_steps + 1.0) * self.dt
        return np.append(0.0, np.cumsum(self.lengths()))

    def end_of(self, phase: Phase) -> Junction:
        """Return the junction at which a phase ends."""
        return next(junction for junction in self.junctions if junction.node == phase.last)

    def sides_of(self, phase: Phase) -> tuple[float, float]:
        """Return the least and the greatest duration of a phase [s]; of the only one also the motion's."""
        low, high = phase.sides
        if len(self.phases) > 1:
            return low, high
        end = self.junctions[-1]
        return max(low, end.earliest), min(high, end.latest)

    def name_of(self, phase: Phase) -> str:
        """Return the name of a phase, or that of the via point at which it ends; empty at the end."""
        return phase.name or next((point.name for point in self.end_of(phase).waypoints), "")


def timeline_of(
    phases: Sequence[Phase],
    conditions: Sequence[Condition],
    switches: SwitchTable | None,
    horizon: Horizon,
    bounds_of_sum: tuple[float, float],
    given_lengths: Array | None = None,
) -> Timeline:
    """Make the timeline of phases and conditions; via points of free times divide a phase without a name.

    Parameters
    ----------
    phases : sequence of Phase
        Those that tables say, or one for all.
    conditions : sequence of ViaConstraint and ContactCondition
        Via points are in the order of the motion.
    switches : SwitchTable or None
    horizon : Horizon
    bounds_of_sum : tuple of float
        Least and greatest duration of the whole [s], where phases with names do not say it; else 0 and
        infinite.
    given_lengths : ndarray, shape (N,), optional
        Lengths of the steps [s].

    Raises
    ------
    ProblemError
        If bounds or guesses of the times contradict their order.
    """
    impacts = switches.schedule.impacts if switches is not None else ()
    times = {**{phase.last: ANY_TIME for phase in phases}, horizon.steps: bounds_of_sum}
    if not phases[0].name:
        phases, times = _divide(phases, conditions, horizon, impacts)
    by_node: dict[int, list[Condition]] = {node: [] for node in (*impacts, *times)}
    for one in conditions:
        by_node.setdefault(one.node, []).append(one)
    junctions = tuple(
        Junction(node, tuple(found), node in impacts, *times.get(node, ANY_TIME))
        for node, found in sorted(by_node.items())
    )
    return Timeline(
        horizon.duration, horizon.duration_range, tuple(phases), junctions, given_lengths, switches
    )


def _divide(
    phases: Sequence[Phase], conditions: Sequence[Condition], horizon: Horizon, impacts: Sequence[int]
) -> tuple[Sequence[Phase], dict[int, tuple[float, float]]]:
    """Divide the only phase at via points of free times; return bounds of times by node, too [s]."""
    timed = find_timed_nodes([one for one in conditions if isinstance(one, ViaConstraint)], horizon)
    times = {one.node: (one.time.earliest, one.time.latest) for one in timed}
    found = phases_between(timed, horizon, impacts) if timed else phases
    return found, {**times, horizon.steps: horizon.sides}
