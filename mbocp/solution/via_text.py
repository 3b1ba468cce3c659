"""What the tables `[[via]]` of a solved problem say of where and when its via points are."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from mbocp._numbers import is_number
from mbocp.terms.span import Place

__all__ = ["ViaPlace", "via_places"]

_MOST_STEPS = 2**53  # numbers of nodes are floats on the way


class ViaPlace(NamedTuple):
    """A via point of a solved problem.

    Attributes
    ----------
    name : str
    node : int
    is_found : bool
        Whether the solver found its time.
    earliest, latest : float
        Bounds of that time [s]; infinite, or 0, where there is none.
    """

    name: str
    node: int
    is_found: bool
    earliest: float
    latest: float


def via_places(
    tables: Sequence[Mapping[str, Any]],
    duration: Any,
    steps: Any,
    phases: Mapping[str, Place] = MappingProxyType({}),
) -> dict[int, ViaPlace]:
    """Via points by the place of their table; what is odd is left out.

    Parameters
    ----------
    tables : sequence of mapping
    duration : float or mapping
        What `horizon.duration` says [s].
    steps : int
        What `horizon.steps` says.
    phases : mapping of str to Place
        Nodes of the phases, by name.
    """
    guess = duration.get("guess") if isinstance(duration, Mapping) else duration
    if not (isinstance(steps, int) and 0 < steps < _MOST_STEPS):
        return {}
    found = {}
    for i, table in enumerate(tables):
        time, share = table.get("time"), table.get("share")
        if isinstance(time, Mapping) and time.get("phase") in phases:
            place, part = phases[time["phase"]], time.get("share", 1.0)
            share, time = place.at(part) / steps if is_number(part) else None, None
        is_found = time == "free" or isinstance(time, Mapping)
        if is_number(time) and is_number(guess) and guess > 0.0:
            share = time / guess
        if is_number(share) and 0.0 <= share <= 1.0:
            bounds = time if isinstance(time, Mapping) else {}
            earliest, latest = bounds.get("min", 0.0), bounds.get("max", math.inf)
            if is_number(earliest) and is_number(latest):
                name = str(table.get("name", ""))
                found[i] = ViaPlace(name, round(share * steps), is_found, earliest, latest)
    return found
