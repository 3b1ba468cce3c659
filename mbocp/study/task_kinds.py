"""Kinds of tasks: those that differ in more than numbers have stage functions of their own.

What tells kinds apart is guessed from the overrides alone. A guess too fine costs one iteration of a task;
one too coarse lets a task compile for itself, and both go unnoticed but for their time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice, product
from typing import Any

from mbocp.study.study import Study, Task

_NUMBERS_MATTER = ("robot", "integrator", "path", "horizon.steps")  # each value makes a kind
_PARAMETERS = {
    "payload",
    "mass",
    "com",
    "inertia",
    "lock",
}  # words of keys below "robot" whose numbers make none
_ZEROS_MATTER = ("cost", "limits")  # terms that are zero are left out of the functions
_MAX_KINDS = 64


def first_of_each_kind(study: Study) -> list[Task]:
    """First task of each kind, of the first few kinds if there are very many."""
    strides, stride = [], len(study)
    for dimension in study.dimensions:
        stride //= len(dimension.points)
        strides.append(stride)
    places = [list(_distinct(dimension.points)) for dimension in study.dimensions]
    chosen = islice(product(*places), _MAX_KINDS)
    indices = (sum(place * step for place, step in zip(p, strides, strict=True)) for p in chosen)
    return [study.task(index) for index in indices]


def _distinct(points: Any) -> Iterator[int]:
    """Place of the first point of each kind."""
    seen: set[Any] = set()
    for place, point in enumerate(points):
        kind = tuple(sorted((key, _kind_of(key, value)) for key, value in point.overrides.items()))
        if kind not in seen:
            seen.add(kind)
            yield place


def _kind_of(key: str, value: Any) -> str:
    """Words that are the same for values that make no difference to the functions."""
    if _is_built_in(key):
        return repr(value)
    if isinstance(value, Mapping):
        return repr(sorted((name, _kind_of(key, entry)) for name, entry in value.items()))
    if isinstance(value, list):
        return repr([_kind_of(key, entry) for entry in value])
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return repr(value)
    return "zero" if key.split(".")[0] in _ZEROS_MATTER and value == 0.0 else "number"


def _is_built_in(key: str) -> bool:
    """Whether functions are made for each value of a key."""
    if key.startswith("robot.") and not _PARAMETERS.isdisjoint(key.split(".")):
        return False
    return any(key == prefix or key.startswith(f"{prefix}.") for prefix in _NUMBERS_MATTER)
