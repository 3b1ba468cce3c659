"""What phases hold and release: the spans and impacts that follow from one phase after the other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, NamedTuple, Protocol, TypeVar

from mbocp.exceptions import ProblemError
from mbocp.problem._checks import check_choice
from mbocp.problem.timeline.hold import Hold, Release

Meeting = Literal["impact", "soft"]
_MEETINGS = ("impact", "soft")


@dataclass(frozen=True)
class PhaseHold:
    """A frame is held throughout a phase.

    Attributes
    ----------
    hold : Hold
        What is held, without spans. The same in the phase before: it goes on.
    meeting : {"impact", "soft"}
        How it begins, after the first phase: velocities leap, inelastically, or they fit already.
    """

    hold: Hold
    meeting: Meeting = "impact"

    def __post_init__(self) -> None:
        check_choice(f"hold {self.hold.name!r}: meeting", self.meeting, _MEETINGS)
        object.__setattr__(self, "hold", replace(self.hold, spans=()))


@dataclass(frozen=True)
class PhaseRelease:
    """A constraint of the robot does not hold throughout a phase.

    Attributes
    ----------
    constraint : str
    meeting : {"impact", "soft"}
        How it is taken on again, where a phase follows that does not release it.
    """

    constraint: str
    meeting: Meeting = "impact"

    def __post_init__(self) -> None:
        check_choice(f"release {self.constraint!r}: meeting", self.meeting, _MEETINGS)


class _Switched(Protocol):
    """What a phase says, see `mbocp.problem.timeline.named_phase.NamedPhase`."""

    # fmt: off
    @property
    def name(self) -> str: ...
    @property
    def steps(self) -> int: ...
    @property
    def holds(self) -> tuple[PhaseHold, ...]: ...
    @property
    def releases(self) -> tuple[PhaseRelease, ...]: ...
    # fmt: on


class Switches(NamedTuple):
    """Holds, releases and impacts as `Problem` has them."""

    holds: tuple[Hold, ...]
    releases: tuple[Release, ...]
    impacts: tuple[int, ...]


T = TypeVar("T")


def takes_switches(phases: Iterable[_Switched]) -> bool:
    """Whether a phase holds or releases anything."""
    return any(phase.holds or phase.releases for phase in phases)


def begin_with_impacts(phases: Sequence[_Switched]) -> tuple[bool, ...]:
    """Which phases begin with a step of no duration, in which velocities leap.

    Raises
    ------
    ProblemError
        If one constraint is to begin with an impact, and another one softly, at the same time.
    """
    return (False, *(_leaps(*both) for both in pairwise(phases)))[: len(phases)]


def _leaps(before: _Switched, phase: _Switched) -> bool:
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


def end_with_partings(phases: Sequence[_Switched]) -> tuple[bool, ...]:
    """Which phases end with a step of no duration, in which velocities become those that are held.

    All that is held up to where something is let go: by the schemes it keeps its place alone.
    """
    return (*(_parts(*both) for both in pairwise(phases)), False)[: len(phases)]


def _parts(phase: _Switched, after: _Switched) -> bool:
    held, released = {one.hold for one in after.holds}, {one.constraint for one in phase.releases}
    ends = any(one.hold not in held for one in phase.holds)
    return ends or any(one.constraint not in released for one in after.releases)


def steps_of(phases: Sequence[_Switched]) -> tuple[int, ...]:
    """Number of steps of each phase, with those of no duration at its beginning and at its end."""
    ends = zip(phases, begin_with_impacts(phases), end_with_partings(phases), strict=True)
    return tuple(phase.steps + leaps + parts for phase, leaps, parts in ends)


def switches_of(phases: Sequence[_Switched]) -> Switches:
    """Spans of all holds and releases in steps of the horizon, and the impacts among these."""
    holds: dict[Hold, list[tuple[int, int]]] = {}
    releases: dict[str, list[tuple[int, int]]] = {}
    impacts, first = [], 0
    ends = zip(begin_with_impacts(phases), end_with_partings(phases), strict=True)
    for phase, count, (leaps, parts) in zip(phases, steps_of(phases), ends, strict=True):
        last = first + count
        for held in phase.holds:
            _extend(holds, held.hold, first, last)
        for released in phase.releases:
            _extend(releases, released.constraint, first, last)
        impacts += [first] * leaps + [last - 1] * parts
        first = last
    return Switches(
        tuple(replace(hold, spans=tuple(spans)) for hold, spans in holds.items()),
        tuple(Release(constraint=name, spans=tuple(spans)) for name, spans in releases.items()),
        tuple(impacts),
    )


def _extend(spans: dict[T, list[tuple[int, int]]], key: T, first: int, last: int) -> None:
    """Add a span, or prolong the one before it."""
    found = spans.setdefault(key, [])
    if found and found[-1][1] == first:
        found[-1] = (found[-1][0], last)
    else:
        found.append((first, last))


def checked_switches(phases: Sequence[_Switched], given: Switches) -> Switches:
    """Those of a problem: what its phases say, or else what it is given.

    Raises
    ------
    ProblemError
        If both say something else.
    """
    if not takes_switches(phases):
        if phases and given.impacts:
            raise ProblemError(
                "impacts: phases have none of their own; say what they hold in the phases, as in "
                "[[phase.hold]], whose impacts follow"
            )
        return given
    found = switches_of(phases)
    for name, asked, own in zip(Switches._fields, given, found, strict=True):
        if asked and asked != own:
            raise ProblemError(f"{name}: follow from what the phases hold and release; leave them out")
    return found
