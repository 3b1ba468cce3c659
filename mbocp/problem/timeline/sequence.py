"""Phases one after the other: where they are, how long all is, and what acts from when to when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np

from mbocp.exceptions import ProblemError
from mbocp.problem.timeline.hold import Hold, Release, Schedule
from mbocp.problem.timeline.phase import Phase
from mbocp.terms.span import NodePlace

_ROUND_OFF = 1e-9  # relative: durations that are the same


class Horizon(NamedTuple):
    """Number of steps and duration of the whole.

    Attributes
    ----------
    steps : int
        Impacts included.
    duration : float
        [s]; a guess where it is free.
    duration_range : tuple of float or None
        Bounds of a free one [s].
    """

    steps: int
    duration: float
    duration_range: tuple[float, float] | None

    @property
    def sides(self) -> tuple[float, float]:
        """Least and greatest duration [s]."""
        return self.duration_range or (self.duration, self.duration)


T = TypeVar("T")


def in_order(phases: Sequence[Phase]) -> tuple[Phase, ...]:
    """Return phases that know their nodes, and with which steps of no duration they begin and end.

    Raises
    ------
    ProblemError
        If one constraint is to begin with an impact, and another one softly, at the same time.
    """
    found, first = [], 0
    leaps = [False, *(_leaps(*both) for both in pairwise(phases))]
    parts = [*(_parts(*both) for both in pairwise(phases)), False]
    for phase, leap, part in zip(phases, leaps, parts, strict=False):
        last = first + phase.steps + leap + part
        found.append(replace(phase, first=first, last=last, leaps=leap, parts=part))
        first = last
    return tuple(found)


def _leaps(before: Phase, phase: Phase) -> bool:
    held, released = {one.hold for one in before.holds}, {one.constraint for one in phase.releases}
    begin = {f"hold {one.hold.name!r}": one.meeting for one in phase.holds if one.hold not in held}
    for one in before.releases:
        if one.constraint not in released:
            begin[f"constraint {one.constraint!r}"] = one.meeting
    found = {meeting: name for name, meeting in begin.items()}
    if len(found) > 1:
        raise ProblemError(
            f'phase {phase.name!r}: {found["impact"]} begins with meeting = "impact", {found["soft"]} with '
            '"soft"; all that begin together take part in an impact: give both the same, or a phase between'
        )
    return "impact" in found


def _parts(phase: Phase, after: Phase) -> bool:
    """Whether something is let go: then all that was held up to there takes part in a parting.

    By the schemes it keeps its place alone.
    """
    held, released = {one.hold for one in after.holds}, {one.constraint for one in phase.releases}
    ends = any(one.hold not in held for one in phase.holds)
    return ends or any(one.constraint not in released for one in after.releases)


def schedule_of(
    said_phase: tuple[Phase, ...],
    said_holds: tuple[Hold, ...],
    said_releases: tuple[Release, ...],
    said_steps_of_impacts: tuple[int, ...],
    free_feet: tuple[Hold, ...],
) -> Schedule:
    """Return spans of all holds and releases, and impacts: what phases say, or else what is given.

    Raises
    ------
    ProblemError
        If both say something else.
    """
    given = Schedule((*said_holds, *free_feet), tuple(said_releases), said_steps_of_impacts)
    if not any(phase.holds or phase.releases for phase in said_phase):
        if said_phase and given.impacts:
            raise ProblemError(
                "impacts: phases have none of their own; say what they hold in the phases, as in "
                "[[phase.hold]], whose impacts follow"
            )
        return given
    found = _schedule_of(said_phase)
    for name, asked, own in zip(Schedule._fields, given, found, strict=True):
        if asked and asked != own:
            raise ProblemError(f"{name}: follow from what the phases hold and release; leave them out")
    return found


def _schedule_of(phases: Sequence[Phase]) -> Schedule:
    holds: dict[Hold, list[tuple[int, int]]] = {}
    releases: dict[str, list[tuple[int, int]]] = {}
    impacts = []
    for phase in phases:
        for held in phase.holds:
            _extend(holds, held.hold, phase)
        for released in phase.releases:
            _extend(releases, released.constraint, phase)
        impacts += [phase.first] * phase.leaps + [phase.last - 1] * phase.parts
    return Schedule(
        tuple(replace(hold, spans=tuple(spans)) for hold, spans in holds.items()),
        tuple(Release(constraint=name, spans=tuple(spans)) for name, spans in releases.items()),
        tuple(impacts),
    )


def _extend(spans: dict[T, list[tuple[int, int]]], key: T, phase: Phase) -> None:
    """Add the steps of a phase, or prolong the span before it."""
    found = spans.setdefault(key, [])
    if found and found[-1][1] == phase.first:
        found[-1] = (found[-1][0], phase.last)
    else:
        found.append((phase.first, phase.last))


def horizon_of(phases: Sequence[Phase]) -> Horizon:
    """Return what phases come to."""
    duration = float(sum(phase.duration for phase in phases))
    bounds = None
    if any(phase.is_free for phase in phases):
        sides = [phase.sides for phase in phases]
        bounds = float(sum(low for low, _ in sides)), float(sum(high for _, high in sides))
    return Horizon(phases[-1].last, duration, bounds)


def spread_phases(phases: Sequence[Phase], total: Horizon) -> tuple[tuple[Phase, ...], tuple[float, float]]:
    """Return phases whose durations come to that of the horizon, and bounds of their sum.

    Returns
    -------
    phases : tuple of Phase
    bounds : tuple of float
        Least and greatest sum [s]; 0 and infinite where the phases say it.

    Raises
    ------
    ProblemError
        If names are not one for each, or the horizon contradicts its phases.
    """
    own, names = horizon_of(phases), [phase.name for phase in phases]
    for name in names:
        if names.count(name) > 1:
            raise ProblemError(f"phase {name!r}: there are several of this name; give each its own")
    if total.steps != own.steps:
        raise ProblemError(
            f"horizon.steps: got {total.steps}, but the phases have {own.steps} in all; leave it out, or "
            "change the steps of a phase"
        )
    return _spread(phases, total.duration), _bounds_of_sum(own, total)


def _bounds_of_sum(own: Horizon, total: Horizon) -> tuple[float, float]:
    """Return bounds of the horizon that those of phases do not imply."""
    (low, high), (least, most) = own.sides, total.sides
    room = _ROUND_OFF * high
    if least > high + room or most < low - room or (own.duration_range is None and least < most):
        raise ProblemError(
            f"horizon.duration: got {_words(least, most)}, but the phases take {_words(low, high)} in all; "
            "leave it out, or change the duration of a phase"
        )
    return least if least > low + room else 0.0, most if most < high - room else np.inf


def _words(low: float, high: float) -> str:
    return f"{low:g} s" if low == high else f"{low:g} to {high:g} s"


def _spread(phases: Sequence[Phase], total: float) -> tuple[Phase, ...]:
    """Move guesses towards their bounds, all by the same share of what there is, until they sum up."""
    guesses = np.array([phase.duration for phase in phases])
    missing = total - guesses.sum()
    if abs(missing) <= _ROUND_OFF * total:
        return tuple(phases)
    ends = np.array([phase.sides[int(missing > 0.0)] for phase in phases])
    whole = (ends - guesses).sum()
    share = min(missing / whole, 1.0) if whole else 0.0
    found = guesses + share * (ends - guesses)
    return tuple(replace(phase, duration=float(value)) for phase, value in zip(phases, found, strict=True))


def are_alike(phases: Sequence[Phase]) -> bool:
    """Return whether all steps are as long as each other, and given."""
    lengths = np.array([phase.dt for phase in phases])
    is_free = any(phase.is_free for phase in phases)
    return not is_free and bool(np.ptp(lengths) <= _ROUND_OFF * lengths.mean()) if len(phases) else True


def places_of(phases: Sequence[Phase]) -> dict[str, NodePlace]:
    """Return where the phases with names are, by name."""
    return {phase.name: phase.place for phase in phases if phase.name}
