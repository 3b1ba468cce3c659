"""Where via points are: their order, their nodes, and which of the nodes have a time that is found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from mbocp._arrays import Array
from mbocp._text import shown
from mbocp._warn import warn_caller
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem._checks import ProblemWarning
from mbocp.problem.timeline.phases import Mark
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.timeline.via_time import FreeTime, InPhase
from mbocp.robot import Robot
from mbocp.terms.span import Place

_ON_NODE = 1e-6  # of a step
_LEAST_LEG = 0.25  # of the mean way between neighbours


def via_nodes(
    via: Sequence[ViaPoint],
    num_steps: int,
    duration: float,
    duration_range: tuple[float, float] | None,
    *,
    phases: Mapping[str, Place] = MappingProxyType({}),
    are_alike: bool = True,
) -> tuple[int | None, ...]:
    """The node of each via point, the nearest to its time; None where nothing says it yet.

    Parameters
    ----------
    duration : float
        [s]; its guess where it is free.
    duration_range : tuple of float or None
        Bounds of a free duration [s].
    phases : mapping of str to Place
        Nodes of the phases by name.
    are_alike : bool
        Whether all steps of the phases are as long as each other, and given.

    Raises
    ------
    InvalidValue, ProblemError
        If a time is outside the horizon, nearest to its start or end, or the time of another via point.
    """
    has_free = any(point.is_free for point in via)
    has_times = has_free or any(point.time is not None for point in via)
    found: list[int | None] = []
    for point in via:
        key = f"via {point.name!r}"
        if point.time is None and point.share is None:
            raise ProblemError(f'{key}: when is it? Give time or share; time = "free" has it found')
        _check_phase(point, key, phases, are_alike=are_alike)
        if point.time is None and has_times and duration_range is not None:
            raise ProblemError(
                f"{key}: share is part of a duration that is free, as are times of via points; give it a "
                f'time: a number, bounds, or "free" beside the share'
            )
        share = _share(point, key, duration, duration_range)
        if isinstance(point.time, InPhase):
            share = phases[point.time.name].at(point.time.share) / num_steps
        node = None if share is None else round(share * num_steps)
        if node is None or share is None:
            found.append(None)
            continue
        if not 0 < node < num_steps:
            where = "start" if node == 0 else "end"
            raise ProblemError(
                f"{key}: the nearest node is the {where} of the motion; say it in "
                f"{'start' if node == 0 else 'goal'}, or take more steps"
            )
        if node in found:
            raise ProblemError(
                f"{key}: at node {node}, as via {via[found.index(node)].name!r}; say both in one, or take "
                "another time"
            )
        is_exact = has_free or (point.time is not None and duration_range is not None) or bool(phases)
        if abs(node - share * num_steps) > _ON_NODE and not is_exact:
            at = (
                f"share {node / num_steps:.6g}"
                if duration_range is not None
                else f"t = {node * duration / num_steps:.6g} s"
            )
            warn_caller(
                f"{key}: between two nodes; it holds at the nearest one, {at}",
                ProblemWarning,
            )
        found.append(node)
    return tuple(found)


def _check_phase(point: ViaPoint, key: str, phases: Mapping[str, Place], *, are_alike: bool) -> None:
    """Refuse phases that there are not, and times that say no node of phases."""
    if isinstance(point.time, InPhase):
        if not phases:
            raise ProblemError(
                f'{key}: time: got {shown(point.time.name)}, expected a number of seconds, "free", or a '
                "table with min, max and, if you like, guess; or the name of a phase, where there are some"
            )
        if point.time.name not in phases:
            known = ", ".join(map(repr, phases)) or "none"
            raise ProblemError(
                f"{key}: time: no phase {point.time.name!r}; there are {known}; give one of them, a "
                'number of seconds, "free", or a table with min and max'
            )
        return
    if point.is_free and phases:
        raise ProblemError(
            f"{key}: time: times that are found are those between phases; name the phase at whose end it is, "
            'as in time = "name"'
        )
    if phases and not are_alike:
        word = "time" if point.time is not None else "share"
        raise ProblemError(
            f"{key}: {word}: steps of phases are of several lengths; name the phase at whose end it is, as "
            'in time = "name", or give time = { phase = "name", share = number }'
        )


def _share(
    point: ViaPoint, key: str, duration: float, duration_range: tuple[float, float] | None
) -> float | None:
    """Which part of the steps leads to a via point; None where nothing says it."""
    latest = duration if duration_range is None else duration_range[1]
    time = point.time
    if isinstance(time, FreeTime):
        if time.earliest >= latest:
            raise InvalidValue(
                f"{key}: time.min", time.earliest, f"a time within the horizon of {latest:g} s"
            )
        if point.share is not None or time.guess is None:
            return point.share
        time = time.guess
    if time is None or isinstance(time, InPhase):
        return point.share
    if time > latest:
        raise InvalidValue(f"{key}: time", time, f"a time within the horizon of {latest:g} s")
    if time >= duration and duration_range is not None:
        raise ProblemError(
            f"{key}: time: {time:g} s is not before the guess of the duration, {duration:g} s; give a "
            "greater horizon.duration.guess"
        )
    return time / duration


def via_order(via: Sequence[ViaPoint], nodes: Sequence[int | None]) -> list[int]:
    """Indices of via points in the order of the motion: by nodes, or as written where some have none yet.

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


def placed(
    robot: Robot,
    via: Sequence[ViaPoint],
    nodes: Sequence[int | None],
    q_start: Array,
    q_end: Array,
    num_steps: int,
) -> tuple[int, ...]:
    """Nodes of via points in the order of the motion: those without one by the lengths of the way between.

    A leg of the way counts at least as a quarter of the mean one.

    Raises
    ------
    ProblemError
        If there are fewer steps than points.
    """
    if not via:
        return ()
    stops = [0, *nodes, num_steps]
    qs = [q_start, *(point.goal.q for point in via), q_end]
    ways = np.array([np.linalg.norm(robot.difference(a, b)) for a, b in pairwise(qs)])
    ways = np.maximum(ways, _LEAST_LEG * ways.mean()) if ways.any() else np.ones(len(ways))
    for i in range(1, len(stops) - 1):
        if stops[i] is not None:
            continue
        before, until = stops[i - 1] or 0, next(k for k in range(i, len(stops)) if stops[k] is not None)
        last = stops[until] or 0
        share = ways[i - 1] / ways[i - 1 : until].sum()
        node = round(before + share * (last - before))
        stops[i] = max(before + 1, min(node, last - (until - i)))
        if not before < (stops[i] or 0) < last:
            raise ProblemError(
                f"via {via[i - 1].name!r}: there is no node for it between those before and after it; take "
                "more steps"
            )
    return tuple(node or 0 for node in stops[1:-1])


def via_marks(
    via: Sequence[ViaPoint], nodes: Sequence[int], num_steps: int, duration: float, *, is_free: bool
) -> tuple[Mark, ...]:
    """Nodes whose times are found, from via points in the order of the motion.

    Where any time is free, others that are given are bounds that equal each other. Without one a node of a
    free duration has none.
    """
    if not any(point.is_free for point in via) and not (
        is_free and any(point.time is not None for point in via)
    ):
        return ()
    found = []
    for point, node in zip(via, nodes, strict=True):
        time = point.time
        if time is None or isinstance(time, InPhase):
            time = (point.share or 0.0) * duration
        if not isinstance(time, FreeTime):
            time = FreeTime(time, time, time)
        guess = node / num_steps * duration if time.guess is None else time.guess
        found.append(Mark(point.name, node, time.earliest, time.latest, guess, time.guess is not None))
    return tuple(found)
