"""Where via points are: their nodes, and their order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp._text import show, warn_caller
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem._checks import ProblemWarning
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.sequence import Horizon, are_alike, places_of
from mbocp.problem.timeline.times import FreeTime, InPhase
from mbocp.problem.timeline.via import ViaPoint
from mbocp.robot import Robot
from mbocp.terms.span import NodePlace

_ON_NODE = 1e-6  # of a step
_LEAST_LEG = 0.25  # of the mean way between neighbours


def via_nodes(
    via: Sequence[ViaPoint], horizon: Horizon, phases: Sequence[Phase] = ()
) -> tuple[int | None, ...]:
    """Return the node of each via point, the nearest to its time; None where nothing says it yet.

    Raises
    ------
    InvalidValue, ProblemError
        If a time is outside the horizon, nearest to its start or end, or the time of another via point.
    """
    has_free = any(point.is_free for point in via)
    has_times = any(point.time is not None for point in via)
    steps = _Steps(horizon, places_of(phases), are_alike(phases), has_free, has_times)
    found: list[int | None] = []
    for point in via:
        share = steps.share_of(point)
        node = None if share is None else round(share * horizon.steps)
        if node is not None and share is not None:
            _check_node(node, share, point, horizon.steps, dict(zip(found, via, strict=False)))
            steps.warn_between(point, node, share)
        found.append(node)
    return tuple(found)


def _check_node(
    node: int, share: float, point: ViaPoint, num_steps: int, taken: Mapping[int | None, ViaPoint]
) -> None:
    key = f"via {point.name!r}"
    if not 0 < node < num_steps:
        where, table = ("start", "start") if node == 0 else ("end", "goal")
        steps = "" if share in (0.0, 1.0) else ", or take more steps"
        raise ProblemError(f"{key}: the nearest node is the {where} of the motion; say it in {table}{steps}")
    if node in taken:
        raise ProblemError(
            f"{key}: at node {node}, as via {taken[node].name!r}; say both in one, or take another time"
        )


@dataclass(frozen=True)
class _Steps:
    """What nodes of via points follow from.

    Attributes
    ----------
    horizon : Horizon
    phases : mapping of str to NodePlace
        Nodes of the phases with names.
    are_alike : bool
        Whether all steps of the phases are as long as each other, and given.
    has_free, has_times : bool
        Whether times of via points are found, and whether any is said.
    """

    horizon: Horizon
    phases: Mapping[str, NodePlace]
    are_alike: bool
    has_free: bool
    has_times: bool

    def share_of(self, point: ViaPoint) -> float | None:
        """Return which part of the steps leads to a via point; None where nothing says it."""
        key, time = f"via {point.name!r}", point.time
        if time is None and point.share is None:
            raise ProblemError(f'{key}: when is it? Give time or share; time = "free" has it found')
        self._check_phase(point, key)
        if time is None and self.has_times and self.horizon.duration_range is not None:
            raise ProblemError(
                f"{key}: share is part of a duration that is free, as are times of via points; give it a "
                f'time: a number, bounds, or "free" beside the share'
            )
        if isinstance(time, InPhase):
            return self.phases[time.name].at(time.share) / self.horizon.steps
        if isinstance(time, FreeTime):
            return self._share_of_free(time, point.share, key)
        return point.share if time is None else self._share_at(time, key)

    def warn_between(self, point: ViaPoint, node: int, share: float) -> None:
        """Warn where a time is between two nodes, and no length of a step can change that."""
        horizon, is_free = self.horizon, self.horizon.duration_range is not None
        is_exact = self.has_free or (point.time is not None and is_free) or bool(self.phases)
        if is_exact or abs(node - share * horizon.steps) <= _ON_NODE:
            return
        time = f"t = {node * horizon.duration / horizon.steps:.6g} s"
        at = f"share {node / horizon.steps:.6g}" if is_free else time
        words = f"via {point.name!r}: between two nodes; it holds at the nearest one, {at}"
        warn_caller(words, ProblemWarning)

    def _check_phase(self, point: ViaPoint, key: str) -> None:
        """Refuse phases that there are not, and times that say no node of phases."""
        if isinstance(point.time, InPhase):
            self._check_name(point.time.name, key)
            return
        if point.is_free and self.phases:
            raise ProblemError(
                f"{key}: time: times that are found are those between phases; name the phase at whose end it "
                'is, as in time = "name"'
            )
        if self.phases and not self.are_alike:
            word = "time" if point.time is not None else "share"
            raise ProblemError(
                f"{key}: {word}: steps of phases are of several lengths; name the phase at whose end it is, "
                'as in time = "name", or give time = { phase = "name", share = number }'
            )

    def _check_name(self, name: str, key: str) -> None:
        if not self.phases:
            raise ProblemError(
                f'{key}: time: got {show(name)}, expected a number of seconds, "free", or a '
                "table with min, max and, if you like, guess; or the name of a phase, where there are some"
            )
        if name not in self.phases:
            known = ", ".join(map(repr, self.phases))
            raise ProblemError(
                f"{key}: time: no phase {name!r}; there are {known}; give one of them, a "
                'number of seconds, "free", or a table with min and max'
            )

    def _share_of_free(self, time: FreeTime, share: float | None, key: str) -> float | None:
        latest = self._latest
        if time.earliest >= latest:
            raise InvalidValue(
                f"{key}: time.min", time.earliest, f"a time within the horizon of {latest:g} s"
            )
        if share is not None or time.guess is None:
            return share
        return self._share_at(time.guess, key)

    def _share_at(self, time: float, key: str) -> float:
        horizon, latest = self.horizon, self._latest
        if time > latest:
            raise InvalidValue(f"{key}: time", time, f"a time within the horizon of {latest:g} s")
        if time >= horizon.duration and horizon.duration_range is not None:
            raise ProblemError(
                f"{key}: time: {time:g} s is not before the guess of the duration, {horizon.duration:g} s; "
                "give a greater horizon.duration.guess"
            )
        return time / horizon.duration

    @property
    def _latest(self) -> float:
        """When the motion ends at the latest [s]."""
        horizon = self.horizon
        return horizon.duration if horizon.duration_range is None else horizon.duration_range[1]


def via_order(via: Sequence[ViaPoint], nodes: Sequence[int | None]) -> list[int]:
    """Return indices of via points in the order of the motion: by nodes, or as written where some have none.

    Raises
    ------
    ProblemError
        If the nodes that there are contradict the order in which the points are written.
    """
    known = [(node, point) for node, point in zip(nodes, via, strict=True) if node is not None]
    if len(known) == len(via):
        return sorted(range(len(via)), key=lambda i: nodes[i] or 0)
    for (node, point), (following, after) in pairwise(known):
        if node > following:
            raise ProblemError(
                f"via {after.name!r}: it is written after via {point.name!r} and comes before it; write via "
                "points of free times in the order of the motion, or give each a share"
            )
    return list(range(len(via)))


def place_via_points(
    robot: Robot,
    via: Sequence[ViaPoint],
    nodes: Sequence[int | None],
    q_start: Array,
    q_end: Array,
    num_steps: int,
) -> tuple[int, ...]:
    """Return nodes of via points in order: those without one by the lengths of the way between.

    A leg of the way counts at least as a quarter of the mean one.

    Raises
    ------
    ProblemError
        If there are fewer steps than points.
    """
    stops = [0, *nodes, num_steps]
    ways = _ways(robot, [q_start, *(point.goal.q for point in via), q_end])
    for i, point in enumerate(via, start=1):
        if stops[i] is not None:
            continue
        before, until = stops[i - 1] or 0, next(k for k in range(i, len(stops)) if stops[k] is not None)
        last = stops[until] or 0
        share = ways[i - 1] / ways[i - 1 : until].sum()
        node = max(before + 1, min(round(before + share * (last - before)), last - (until - i)))
        if not before < node < last:
            raise ProblemError(
                f"via {point.name!r}: there is no node for it between those before and after it; take more "
                "steps"
            )
        stops[i] = node
    return tuple(node or 0 for node in stops[1:-1])


def _ways(robot: Robot, qs: Sequence[Array]) -> Array:
    """Return lengths of the legs from one configuration to the next."""
    found = np.array([np.linalg.norm(robot.difference(a, b)) for a, b in pairwise(qs)])
    return np.maximum(found, _LEAST_LEG * found.mean()) if found.any() else np.ones(len(found))
