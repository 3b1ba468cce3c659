"""Phases: runs of steps that are as long as each other, whose length the solver finds.

Where a time between start and end is free, the steps before it and after it have lengths of their own. Times
of nodes at which phases end may have bounds; equal ones give the time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.problem.timeline.named_phase import NamedPhase, are_alike, phase_lengths, phase_nodes
from mbocp.problem.timeline.phase_holds import begin_with_impacts, end_with_partings
from mbocp.problem.timeline.phase_time import least_time

_ROOM = 0.05  # of that mean length: what a guess leaves for the steps of a phase at least, where bounds do


@dataclass(frozen=True)
class Mark:
    """A node whose time is found, at which a phase ends and another begins.

    Attributes
    ----------
    name : str
        What it is called in messages.
    node : int
    earliest, latest : float
        Bounds of its time [s].
    guess : float
        Of its time [s].
    is_given : bool
        Whether the user gave the guess.
    """

    name: str
    node: int
    earliest: float
    latest: float
    guess: float
    is_given: bool = False


@dataclass(frozen=True)
class Phase:
    """Steps of one length that is found with the motion.

    Attributes
    ----------
    first, last : int
        Nodes where it begins and ends.
    duration : float
        A guess of it [s].
    shortest, longest : float
        Bounds of its duration [s].
    earliest, latest : float
        Bounds of the time at its end [s].
    name : str
        Of the mark at its end; "" for the end of the motion.
    num_impacts : int
        Number of its steps of no duration.
    """

    first: int
    last: int
    duration: float
    shortest: float
    longest: float
    earliest: float
    latest: float
    name: str = ""
    num_impacts: int = 0

    @property
    def num_steps(self) -> int:
        """Number of its steps that take time."""
        return self.last - self.first - self.num_impacts


def phases_between(
    marks: Sequence[Mark],
    num_steps: int,
    duration: float,
    bounds: tuple[float, float],
    impacts: Sequence[int] = (),
) -> tuple[Phase, ...]:
    """Phases from the start over the marks, in the order of their nodes, to the end.

    Parameters
    ----------
    marks : sequence of Mark
    num_steps : int
    duration : float
        Guess of the whole [s].
    bounds : tuple of float
        Least and greatest duration of the whole [s]; equal where it is given.
    impacts : sequence of int
        Steps of no duration.

    Raises
    ------
    ProblemError
        If bounds or guesses of the times contradict their order.
    """
    if not marks:
        return (Phase(0, num_steps, duration, *bounds, *bounds, num_impacts=len(impacts)),)
    stops = [*marks, Mark("", num_steps, *bounds, duration, is_given=True)]
    nodes = [0, *(stop.node for stop in stops)]
    leaps = [sum(first <= step < last for step in impacts) for first, last in pairwise(nodes)]
    steps = [last - first - leap for (first, last), leap in zip(pairwise(nodes), leaps, strict=True)]
    timed = num_steps - len(impacts)
    shortest = [least_time(count, timed, bounds[0]) for count in steps]
    _check_bounds(stops, shortest)
    _check_guesses(stops)
    times = _guessed(stops, shortest, [_ROOM * count * bounds[0] / timed for count in steps])
    befores = [0.0, *times]
    return tuple(
        Phase(
            first=nodes[i],
            last=nodes[i + 1],
            duration=times[i] - befores[i],
            shortest=shortest[i],
            longest=math.inf,
            earliest=stop.earliest,
            latest=stop.latest,
            name=stop.name,
            num_impacts=leaps[i],
        )
        for i, stop in enumerate(stops)
    )


def free_phases(
    named: Sequence[NamedPhase], duration: float, bounds: tuple[float, float]
) -> tuple[Phase, ...]:
    """Phases of free lengths from those with a name; none where all durations are given.

    Parameters
    ----------
    named : sequence of NamedPhase
    duration : float
        Guess of the whole [s], the sum of theirs.
    bounds : tuple of float
        Least and greatest duration of the whole [s], where the phases do not say it; else 0 and infinite.
    """
    if not any(phase.is_free for phase in named):
        return ()
    nodes, last = phase_nodes(named), len(named) - 1
    leaps, parts = begin_with_impacts(named), end_with_partings(named)
    found = []
    for i, phase in enumerate(named):
        low, high = phase.duration_range or (phase.duration, phase.duration)
        least, most = bounds if i == last else (0.0, math.inf)
        if last == 0:  # its duration is that of the whole
            low, high = max(low, least), min(high, most)
        first_last, leap = nodes[phase.name], leaps[i] + parts[i]
        found.append(Phase(*first_last, phase.duration, low, high, least, most, phase.name, leap))
    return tuple(found)


class _Horizon(Protocol):
    """What a problem says of its steps, see `mbocp.problem.Problem`."""

    # fmt: off
    @property
    def dt(self) -> float: ...
    @property
    def num_steps(self) -> int: ...
    @property
    def phases(self) -> tuple[Phase, ...]: ...
    @property
    def impacts(self) -> tuple[int, ...]: ...
    @property
    def phase(self) -> tuple[NamedPhase, ...]: ...
    @property
    def lengths(self) -> Array | None: ...
    # fmt: on


def step_lengths(problem: _Horizon) -> Array:
    """Lengths of the steps [s], or their guess, shape (N,)."""
    if problem.lengths is not None:
        return np.array(problem.lengths)
    lengths = np.full(problem.num_steps, problem.dt)
    if len(problem.phases) > 1:
        for phase in problem.phases:
            lengths[phase.first : phase.last] = phase.duration / phase.num_steps
    elif not are_alike(problem.phase):
        lengths = phase_lengths(problem.phase)
    lengths[list(problem.impacts)] = 0.0
    return lengths


def node_times(problem: _Horizon) -> Array:
    """Times of the nodes [s], or their guess, shape (N + 1,)."""
    is_even = problem.lengths is None and len(problem.phases) < 2 and are_alike(problem.phase)
    if is_even and not problem.impacts:
        return np.arange(problem.num_steps + 1.0) * problem.dt
    return np.append(0.0, np.cumsum(step_lengths(problem)))


def _check_bounds(stops: Sequence[Mark], shortest: Sequence[float]) -> None:
    earliest, before = 0.0, "the start"
    for stop, least in zip(stops, shortest, strict=True):
        soonest = earliest + least
        if stop.latest < soonest:
            what = f"via {stop.name!r}: time" if stop.name else "horizon.duration"
            raise ProblemError(
                f"{what}: at most {stop.latest:g} s, but {before} before it is not before {earliest:g} s; "
                "give times that rise with the places of the nodes, or other shares"
            )
        if stop.earliest >= soonest:
            before = f"via {stop.name!r}"
        earliest = max(stop.earliest, soonest)


def _check_guesses(stops: Sequence[Mark]) -> None:
    given = [stop for stop in stops if stop.is_given]
    for before, after in pairwise(given):
        if not before.guess < after.guess:
            later = f"via {after.name!r}" if after.name else "the end"
            raise ProblemError(
                f"via {before.name!r}: time.guess: {before.guess:g} s is not before the guess of {later}, "
                f"{after.guess:g} s; give guesses that rise with the places of the nodes"
            )


def _guessed(stops: Sequence[Mark], shortest: Sequence[float], wanted: Sequence[float]) -> list[float]:
    """Times that rise, within the bounds, near the guesses; with room for the steps where bounds leave it."""
    for room in (wanted, shortest):
        lower, upper, least = [], [stops[-1].guess], 0.0
        for stop, gap in zip(stops, room, strict=True):
            least = max(stop.earliest, least + gap)
            lower.append(least)
        for stop, gap in zip(stops[-2::-1], room[:0:-1], strict=True):
            upper.insert(0, min(stop.latest, upper[0] - gap))
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
