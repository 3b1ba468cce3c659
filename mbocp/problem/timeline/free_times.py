"""Times that are found: phases between via points, whose lengths the solver finds.

Where a time between start and end is free, the steps before it and after it have lengths of their own. Times
of nodes at which phases end may have bounds; equal ones give the time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

from mbocp.exceptions import ProblemError
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.sequence import Horizon
from mbocp.problem.timeline.times import FreeTime, least_time
from mbocp.problem.timeline.via import ViaConstraint, ViaPoint

_ROOM = 0.05  # of that mean length: what a guess leaves for the steps of a phase at least, where bounds do


class TimedNode(NamedTuple):
    """A node whose time is found, at which a phase ends.

    Attributes
    ----------
    node : int
    time : FreeTime
        Its bounds, and the guess of it.
    name : str
        Of the via point there; empty at the end.
    has_guess : bool
        Whether the user gave the guess.
    """

    node: int
    time: FreeTime
    name: str = ""
    has_guess: bool = False

    @property
    def guess(self) -> float:
        """Of its time [s]."""
        return self.time.guess or 0.0


def find_timed_nodes(waypoints: Sequence[ViaConstraint], horizon: Horizon) -> tuple[TimedNode, ...]:
    """Return nodes whose times are found, from via points in the order of the motion.

    Where any time is free, others that are given are bounds that equal each other. Without one a node of a
    free duration has none.
    """
    has_times = any(point.via.time is not None for point in waypoints)
    has_free = any(point.via.is_free for point in waypoints)
    if not (has_free or (has_times and horizon.duration_range is not None)):
        return ()
    found = []
    for point in waypoints:
        time = _free_time(point.via, horizon.duration)
        guess = point.node / horizon.steps * horizon.duration if time.guess is None else time.guess
        found.append(TimedNode(point.node, replace(time, guess=guess), point.name, time.guess is not None))
    return tuple(found)


def _free_time(point: ViaPoint, duration: float) -> FreeTime:
    """Return the time of a via point; bounds that equal each other where it is given."""
    time = point.time
    if isinstance(time, FreeTime):
        return time
    given = time if isinstance(time, float | int) else (point.share or 0.0) * duration
    return FreeTime(given, given, given)


def phases_between(
    nodes: Sequence[TimedNode], horizon: Horizon, impacts: Sequence[int] = ()
) -> tuple[Phase, ...]:
    """Return phases from the start over nodes with times that are found to the end.

    Parameters
    ----------
    nodes : sequence of TimedNode
        In their order.
    horizon : Horizon
    impacts : sequence of int
        Steps of no duration.

    Raises
    ------
    ProblemError
        If bounds or guesses of the times contradict their order.
    """
    timed, bounds = horizon.steps - len(impacts), horizon.sides
    stops = [*nodes, TimedNode(horizon.steps, FreeTime(*bounds, horizon.duration), has_guess=True)]
    pairs = list(pairwise([0, *(stop.node for stop in stops)]))
    steps = [last - first - sum(first <= step < last for step in impacts) for first, last in pairs]
    shortest = [least_time(count, timed, bounds[0]) for count in steps]
    _check_bounds(stops, shortest)
    _check_guesses(stops)
    times = _guess(stops, shortest, [_ROOM * count * bounds[0] / timed for count in steps])
    return tuple(
        Phase(steps=count, duration=after - before, duration_range=(least, math.inf), first=first, last=last)
        for (first, last), count, least, (before, after) in zip(
            pairs, steps, shortest, pairwise([0.0, *times]), strict=True
        )
    )


def _check_bounds(stops: Sequence[TimedNode], shortest: Sequence[float]) -> None:
    earliest, before = 0.0, "the start"
    for stop, least in zip(stops, shortest, strict=True):
        soonest = earliest + least
        if stop.time.latest < soonest:
            what = f"via {stop.name!r}: time" if stop.name else "horizon.duration"
            raise ProblemError(
                f"{what}: at most {stop.time.latest:g} s, but {before} before it is not before "
                f"{earliest:g} s; give times that rise with the places of the nodes, or other shares"
            )
        if stop.time.earliest >= soonest:
            before = f"via {stop.name!r}"
        earliest = max(stop.time.earliest, soonest)


def _check_guesses(stops: Sequence[TimedNode]) -> None:
    for before, after in pairwise(stop for stop in stops if stop.has_guess):
        if not before.guess < after.guess:
            later = f"via {after.name!r}" if after.name else "the end"
            raise ProblemError(
                f"via {before.name!r}: time.guess: {before.guess:g} s is not before the guess of {later}, "
                f"{after.guess:g} s; give guesses that rise with the places of the nodes"
            )


def _guess(stops: Sequence[TimedNode], shortest: Sequence[float], wanted: Sequence[float]) -> list[float]:
    """Return times that rise, within the bounds, near the guesses; with room for steps where there is any."""
    for room in (wanted, shortest):
        lower, upper, least = [], [stops[-1].guess], 0.0
        for stop, gap in zip(stops, room, strict=True):
            least = max(stop.time.earliest, least + gap)
            lower.append(least)
        for stop, gap in zip(stops[-2::-1], room[:0:-1], strict=True):
            upper.insert(0, min(stop.time.latest, upper[0] - gap))
        if all(low <= high for low, high in zip(lower, upper, strict=True)):
            break
    else:
        raise ProblemError(
            f"horizon.duration: its guess of {stops[-1].guess:g} s leaves no time for the bounds of "
            "via.time; give a greater guess"
        )
    times: list[float] = []
    for stop, low, high, gap in zip(stops, lower, upper, room, strict=True):
        after = times[-1] + gap if times else gap
        times.append(min(max(stop.guess, low, after), high))
    return times
