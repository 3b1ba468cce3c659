"""Numbers of steps of which all multiples have nodes where via points, and parts of constraints, are.

Where an accuracy asks for steps, their number changes from solve to solve, and what is at a node has to stay
where it is: else the problem would change with its steps.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from mbocp.exceptions import ProblemError
from mbocp.problem.path import PathConstraint
from mbocp.problem.timeline.named_phase import NamedPhase
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.timeline.via_time import InPhase
from mbocp.terms import OwnTerm
from mbocp.terms.span import SPAN, AtVia, End, Share, Span

FIRST_STEPS = 20  # with which the search for steps begins
_MOST = 200  # steps among which nodes are looked for
_ON_NODE = 1e-6  # of a step


@dataclass(frozen=True, eq=False)
class Places:
    """What says where nodes are, by the names of `mbocp.problem.Problem`."""

    duration: float
    duration_range: tuple[float, float] | None
    phase: Sequence[NamedPhase]
    via: Sequence[ViaPoint]
    path: Sequence[object]
    terms: Sequence[OwnTerm]


def base_counts(places: Places) -> tuple[int, ...]:
    """Least numbers of steps, one for each phase or one for all, whose multiples have the nodes.

    Raises
    ------
    ProblemError
        If no 200 steps have a node where one is asked for.
    """
    found: dict[str, dict[float, str]] = defaultdict(dict)  # of phases by name: shares, and who asks
    for key, phase, share in _places(places):
        if 0.0 < share < 1.0:
            found[phase][share] = key
    names = [phase.name for phase in places.phase] or [""]
    return tuple(_least(found[name]) for name in names)


def first_count(places: Places) -> int:
    """Number of steps with which a search begins."""
    (base,) = base_counts(places)
    return base * -(-FIRST_STEPS // base)


def has_places(places: Places) -> bool:
    """Whether anything belongs to nodes on the way."""
    return bool(places.via) or any(end is not None for _, span in _spans(places) for end in _ends(span))


def _least(shares: dict[float, str]) -> int:
    for count in range(1, _MOST + 1):
        if all(abs(share * count - round(share * count)) < _ON_NODE for share in shares):
            return count
    told = "; ".join(dict.fromkeys(shares.values()))
    raise ProblemError(
        f"horizon.accuracy: {told}: no {_MOST} steps or fewer have nodes at these parts of the motion; take "
        "rounder ones, or give horizon.steps in its place"
    )


def _places(places: Places) -> Iterator[tuple[str, str, float]]:
    """Who asks for a node, the phase in which it is, and at which part of it."""
    are_found = any(point.is_free for point in places.via) or places.duration_range is not None
    for point in places.via:
        key = f"via {point.name!r}"
        if isinstance(point.time, InPhase):
            yield key, point.time.name, point.time.share
        elif point.time is None and point.share is not None and not point.is_free:
            yield key, _whole(places, key), point.share
        elif isinstance(point.time, float) and not are_found:
            yield key, _whole(places, key), point.time / places.duration
    phases = {phase.name for phase in places.phase}
    for key, span in _spans(places):
        for side, end in zip(SPAN, _ends(span), strict=True):
            if isinstance(end, AtVia):
                if end.name in phases and end.share is not None:
                    yield f"{key}: {side}", end.name, end.share
            elif end is not None:
                share = end.value if isinstance(end, Share) else end / places.duration
                yield f"{key}: {side}", _whole(places, f"{key}: {side}"), share


def _whole(places: Places, key: str) -> str:
    """The name of all steps; refused where they belong to phases."""
    if places.phase:
        raise ProblemError(
            f"horizon.accuracy: {key}: each phase gets a number of steps of its own; say a part of a phase: "
            "{ phase = name, share = number }"
        )
    return ""


def _spans(places: Places) -> Iterator[tuple[str, Span]]:
    for constraint in places.path:
        if isinstance(constraint, PathConstraint):
            yield f"path {constraint.name!r}", constraint.span
    for term in places.terms:
        if term.role == "path":
            yield f"term {term.name!r}", term.span


def _ends(span: Span) -> tuple[End, End]:
    return span.since, span.until
