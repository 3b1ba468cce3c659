"""What the tables `[[phase]]` of a solved problem say of its phases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from mbocp._arrays import Array
from mbocp._numbers import is_number
from mbocp.solution.path_text import are_pairs

__all__ = ["PhasePlace", "bounds_in_phases", "hold_names", "phase_places"]


class PhasePlace(NamedTuple):
    """A phase of a solved problem.

    Attributes
    ----------
    name : str
    first, last : int
        Nodes where it begins and ends; an impact at its beginning is part of it.
    shortest, longest : float
        Bounds of its duration [s]; the same where it was given.
    has_impact : bool
        Whether its first step takes no time.
    has_parting : bool
        Whether its last step takes no time.
    """

    name: str
    first: int
    last: int
    shortest: float
    longest: float
    has_impact: bool = False
    has_parting: bool = False

    @property
    def is_free(self) -> bool:
        """Whether the solver found its duration."""
        return self.shortest < self.longest


def phase_places(tables: Sequence[Mapping[str, Any]], steps: Any) -> tuple[PhasePlace, ...]:
    """Phases in their order; none where a table is odd, or they are not all `steps` together.

    `steps` is None where an accuracy asked for them: then the phases alone have numbers of steps.
    """
    found, first, taken = [], 0, [_taken(table) for table in tables]
    for place, table in enumerate(tables):
        count, duration = table.get("steps"), table.get("duration")
        sides = (
            (duration.get("min"), duration.get("max"))
            if isinstance(duration, Mapping)
            else (duration, duration)
        )
        if not (isinstance(count, int) and count > 0 and is_number(sides[0]) and is_number(sides[1])):
            return ()
        leaps = place > 0 and _begins_with_impact(taken[place - 1], taken[place])
        parts = place + 1 < len(taken) and _ends_with_parting(taken[place], taken[place + 1])
        last = first + count + leaps + parts
        found.append(PhasePlace(str(table.get("name", "")), first, last, sides[0], sides[1], leaps, parts))
        first = last
    return tuple(found) if steps in (None, first) else ()


class _Taken(NamedTuple):
    """How what a phase holds begins, and what it releases ends: "impact" or "soft"."""

    holds: Mapping[str, str] = MappingProxyType({})
    releases: Mapping[str, str] = MappingProxyType({})


def _taken(table: Mapping[str, Any]) -> _Taken:
    """Holds by all that makes them the same, releases by name."""
    both = []
    for key in ("hold", "release"):
        written = table.get(key)
        entries = [one for one in written if isinstance(one, Mapping)] if isinstance(written, list) else []
        both.append({_identity(one): str(one.get("meeting", "impact")) for one in entries})
    return _Taken(*both)


def _identity(entry: Mapping[str, Any]) -> str:
    return repr(sorted((key, value) for key, value in entry.items() if key != "meeting"))


def _begins_with_impact(before: _Taken, now: _Taken) -> bool:
    begin = [meeting for key, meeting in now.holds.items() if key not in before.holds]
    begin += [meeting for key, meeting in before.releases.items() if key not in now.releases]
    return "impact" in begin


def _ends_with_parting(now: _Taken, after: _Taken) -> bool:
    return not (now.holds.keys() <= after.holds.keys() and after.releases.keys() <= now.releases.keys())


def hold_names(tables: Sequence[Mapping[str, Any]]) -> frozenset[str]:
    """Names of what phases hold."""
    holds = [table.get("hold") for table in tables]
    entries = [one for written in holds if isinstance(written, list) for one in written]
    return frozenset(str(one.get("name", "")) for one in entries if isinstance(one, Mapping))


def bounds_in_phases(
    tables: Sequence[Mapping[str, Any]],
    places: Sequence[PhasePlace],
    key: str,
    whole: Array,
    *,
    at_nodes: bool,
) -> Array:
    """Bounds of a key of `[limits]` at the nodes 1..N, or in the N steps, shape (2, N, n).

    Parameters
    ----------
    tables : sequence of mapping
        `[[phase]]`, as `mbocp.problem.problem_to_toml` writes them.
    places : sequence of PhasePlace
    key : str
    whole : ndarray, shape (2, n)
        Those of the problem.
    at_nodes : bool
        Whether they hold at nodes: one between two phases belongs to both.
    """
    found = np.repeat(whole[:, None, :], places[-1].last, axis=1)
    for table, place in zip(tables, places, strict=True):
        limits = table.get("limits")
        written = limits.get(key) if isinstance(limits, Mapping) else None
        own = np.array(written, dtype=float).T if are_pairs(written) else np.zeros((2, 0))
        own = own if own.shape == whole.shape else np.array([[-np.inf], [np.inf]])
        is_own = np.isfinite(own).any(axis=0)
        rows = np.where(is_own, own, whole)
        found[:, place.first : place.last] = rows[:, None]
        if at_nodes and place.first:
            if place.has_impact and key == "velocity":  # it leaps from one to the other
                continue
            before = found[:, place.first - 1]
            found[:, place.first - 1] = np.maximum(before[0], rows[0]), np.minimum(before[1], rows[1])
    return found
