"""Which steps there are: given lengths that differ, an accuracy in place of their number, nodes asked for.

Where an accuracy asks for steps, their number changes from solve to solve, and what is at a node has to stay
where it is: else the problem would change with its steps. So numbers of steps are multiples of the least one
that has nodes where via points, and parts of constraints, are.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem._checks import check_finite, check_number
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.path import PathConstraint
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.timeline import Timeline
from mbocp.problem.timeline.times import InPhase
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.weights import Cost
from mbocp.terms import OwnTerm
from mbocp.terms.bounded import BoundedTerm
from mbocp.terms.span import SPAN, AtVia, End, Share, Span

FIRST_STEPS = 20  # with which the search for steps begins
_MOST = 200  # steps among which nodes are looked for
_ON_NODE = 1e-6  # of a step
_FINEST, _COARSEST = 1e-10, 0.1  # what flows are sure of; beyond, a motion is hardly one
_ROUND_OFF = 1e-9  # relative: durations that are the same
_WIDEST = 1e6  # ratio of the longest step and the shortest


def check_accuracy(value: Any) -> float | None:
    """Return the accuracy that is asked for, checked.

    Raises
    ------
    InvalidValue
    """
    if value is None:
        return None
    number = float(check_number("horizon.accuracy", value))  # without the unit of a `Quantity`
    if not _FINEST <= number <= _COARSEST:
        expected = f"a number from {_FINEST:g} to {_COARSEST:g}: rad and m of a step, and a share of the cost"
        raise InvalidValue("horizon.accuracy", number, expected)
    return number


def check_lengths(lengths: Any, num_steps: int, duration: float) -> Array | None:
    """Return lengths of steps [s], checked, shape (N,).

    Raises
    ------
    InvalidValue, ProblemError
        If they are not positive, or not those of the steps and of the duration.
    """
    if lengths is None:
        return None
    found = np.array(lengths, dtype=np.float64)
    if found.shape != (num_steps,):
        raise ProblemError(
            f"horizon.lengths: got shape {found.shape}, expected one number for each of {num_steps} steps"
        )
    check_finite("horizon.lengths", found)
    if found.min() <= 0.0 or found.max() > _WIDEST * found.min():
        worst = int(found.argmin())
        expected = f"a positive number [s], and at least {1 / _WIDEST:g} of the longest"
        raise InvalidValue(f"horizon.lengths[{worst}]", float(found[worst]), expected)
    total = float(found.sum())
    if abs(total - duration) > _ROUND_OFF * duration:
        raise ProblemError(
            f"horizon.lengths: they take {total:.12g} s in all, but horizon.duration is {duration:.12g} s; "
            "leave one of them out"
        )
    return frozen_array(found)


def scale_lengths(lengths: Sequence[float] | Array, duration: float) -> Array:
    """Return lengths of which the sum is a duration [s], to round-off."""
    found = np.array(lengths, dtype=np.float64)
    return found * (duration / found.sum())


@dataclass(frozen=True, eq=False)
class AskedNodes:
    """What says where nodes are: phases, via points, and spans of path constraints and of own terms.

    Attributes
    ----------
    duration : float
        [s]; a guess of it where `duration_range` says that it is free.
    duration_range : tuple of float or None
    phases : sequence of Phase
        Those that have names.
    via : sequence of ViaPoint
    path : sequence
    terms : sequence of OwnTerm
    """

    duration: float
    duration_range: tuple[float, float] | None
    phases: Sequence[Phase]
    via: Sequence[ViaPoint]
    path: Sequence[object]
    terms: Sequence[OwnTerm]

    @classmethod
    def of(cls, timeline: Timeline, path: Sequence[object], terms: Sequence[OwnTerm]) -> AskedNodes:
        """Return what a problem says."""
        via = tuple(point.via for point in timeline.waypoints)
        return cls(timeline.duration, timeline.duration_range, timeline.named_phases, via, path, terms)

    def base_counts(self) -> tuple[int, ...]:
        """Return least numbers of steps, one for each phase or one for all, whose multiples have the nodes.

        Raises
        ------
        ProblemError
            If no 200 steps have a node where one is asked for.
        """
        found: dict[str, dict[float, str]] = defaultdict(dict)  # of phases by name: shares, and who asks
        for key, phase, share in (*self._of_via(), *self._of_spans()):
            if 0.0 < share < 1.0:
                found[phase][share] = key
        names = [phase.name for phase in self.phases] or [""]
        return tuple(_least(found[name]) for name in names)

    def first_count(self) -> int:
        """Return the number of steps with which a search begins."""
        (base,) = self.base_counts()
        return base * -(-FIRST_STEPS // base)

    @property
    def has_any(self) -> bool:
        """Whether anything belongs to nodes on the way."""
        return bool(self.via) or self.has_parts

    @property
    def has_parts(self) -> bool:
        """Whether anything along the path holds in a part of the motion alone."""
        return any(end is not None for _, span in self._spans() for end in (span.since, span.until))

    @property
    def follows_path(self) -> bool:
        """Whether a frame follows a path."""
        return any(isinstance(one, PathConstraint) and one.kind == "follow" for one in self.path)

    def _of_via(self) -> Iterator[tuple[str, str, float]]:
        """Who asks for a node, the phase in which it is, and at which part of it."""
        are_found = any(point.is_free for point in self.via) or self.duration_range is not None
        for point in self.via:
            key = f"via {point.name!r}"
            if isinstance(point.time, InPhase):
                yield key, point.time.name, point.time.share
            elif point.time is None and point.share is not None:
                yield key, self._whole(key), point.share
            elif isinstance(point.time, float) and not are_found:
                yield key, self._whole(key), point.time / self.duration

    def _of_spans(self) -> Iterator[tuple[str, str, float]]:
        """The same, asked by ends of spans."""
        phases = {phase.name for phase in self.phases}
        for key, span in self._spans():
            for side, end in zip(SPAN, (span.since, span.until), strict=True):
                if isinstance(end, AtVia):
                    if end.name in phases and end.share is not None:
                        yield f"{key}: {side}", end.name, end.share
                elif end is not None:
                    yield f"{key}: {side}", self._whole(f"{key}: {side}"), self._share(end)

    def _share(self, end: End) -> float:
        return end.value if isinstance(end, Share) else float(end) / self.duration  # type: ignore[arg-type]

    def _whole(self, key: str) -> str:
        """Return the name of all steps; refused where they belong to phases."""
        if self.phases:
            raise ProblemError(
                f"horizon.accuracy: {key}: each phase gets a number of steps of its own; say a part of a "
                "phase: { phase = name, share = number }"
            )
        return ""

    def _spans(self) -> Iterator[tuple[str, Span]]:
        for constraint in self.path:
            if isinstance(constraint, PathConstraint):
                yield f"path {constraint.name!r}", constraint.span
        for term in self.terms:
            if term.role == "path":
                yield f"term {term.name!r}", term.span


def _least(shares: dict[float, str]) -> int:
    for count in range(1, _MOST + 1):
        if all(abs(share * count - round(share * count)) < _ON_NODE for share in shares):
            return count
    told = "; ".join(dict.fromkeys(shares.values()))
    raise ProblemError(
        f"horizon.accuracy: {told}: no {_MOST} steps or fewer have nodes at these parts of the motion; take "
        "rounder ones, or give horizon.steps in its place"
    )


def check_steps(
    timeline: Timeline,
    accuracy: float | None,
    coordinates: str,
    path: tuple[BoundedTerm, ...],
    terms: tuple[OwnTerm, ...],
    said_cost: Cost,
) -> None:
    """Refuse what steps of different lengths, or steps that are found, do not go with.

    Raises
    ------
    ProblemError
    """
    asked, lengths = AskedNodes.of(timeline, path, terms), timeline.given_lengths
    is_switched = timeline.switches is not None
    targets: list[tuple[object, str]] = [(said_cost.is_trajectory, "a target for each step")]
    if accuracy is not None:
        key = "horizon.accuracy"
        if lengths is not None:
            raise ProblemError(f"{key}: horizon.lengths gives the steps; leave one of them out")
        if is_switched and not asked.phases:
            raise ProblemError(
                f"{key}: does not go with holds, releases and impacts that are given by numbers of steps; "
                "say them in phases, as in [[phase.hold]], whose steps are found, or give horizon.steps in "
                "its place"
            )
        _refuse(key, targets)
        asked.base_counts()
    elif lengths is not None:
        _refuse("horizon.lengths", targets + _refusals(asked, coordinates, is_switched=is_switched))


def _refuse(key: str, found: Sequence[tuple[object, str]]) -> None:
    for is_there, words in found:
        if is_there:
            raise ProblemError(f"{key}: does not go with {words}; give horizon.steps in its place")


def _refusals(asked: AskedNodes, coordinates: str, *, is_switched: bool) -> list[tuple[object, str]]:
    """What does not go with given lengths: whether it is there, and what it is called."""
    has_joint_states = COORDINATES[coordinates].has_joint_states
    is_free = asked.duration_range is not None
    return [
        (is_switched, "constraints that begin or end along the way, whose steps phases give"),
        (not has_joint_states, f'coordinates = "{coordinates}", whose steps are as long as each other'),
        (asked.phases, "[[phase]], of which each has a number of steps"),
        (is_free, "a free horizon.duration, whose steps are as long as each other"),
        (asked.via, "[[via]], which are at nodes of equal steps"),
        (asked.has_parts, "from and until of [[path]]"),
        (asked.follows_path, 'kind = "follow"'),
    ]
