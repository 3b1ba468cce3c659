"""Values that follow from each other, step by step; what has not changed is not worked out again.

A step is a function whose parameters are names of values. It returns the values that it gives. A check gives
none. Where a step gives what it gave before, the value of before stays, and so does all that follows from it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePath
from typing import Any

import numpy as np

from mbocp._arrays import dataclass, is_frozen_value

_PLAIN = (int, float, str, bool, tuple, type(None), PurePath)  # compared by value; all else by identity
_NOTHING = object()  # in the place of a value that is not there


@dataclass(frozen=True)
class Step:
    """A function of values.

    Attributes
    ----------
    work : callable
    takes, gives : tuple of str
        Names of the values that it needs, and of those that it returns: one by itself, several as a tuple.
    """

    work: Callable[..., Any]
    takes: tuple[str, ...]
    gives: tuple[str, ...]

    @classmethod
    def of(cls, work: Callable[..., Any], *gives: str) -> Step:
        """Make a step of a function whose parameters have the names of what it takes."""
        return cls(work, tuple(inspect.signature(work).parameters), gives)

    def run(self, values: Mapping[str, Any]) -> Sequence[Any]:
        """Return what it gives for these values, in the order of its names."""
        result = self.work(*[values[name] for name in self.takes])
        return (result,) if len(self.gives) == 1 else result if self.gives else ()


def run_steps(
    steps: Sequence[Step], given: Mapping[str, Any], before: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return all values: those that are given, and those that the steps give.

    A value that is given stays, whatever step would give it.

    Parameters
    ----------
    steps : sequence of Step
    given : mapping of str
    before : mapping of str, optional
        What an earlier run returned. A step that takes the same as then gives the same.
    """
    values, then = dict(given), before or {}
    changed = {
        name
        for name, value in given.items()
        if (old := then.get(name, _NOTHING)) is not value and not _equals(value, old)
    }
    for step in steps:
        gives = step.gives
        if gives and all(map(given.__contains__, gives)):
            continue
        if then and changed.isdisjoint(step.takes) and all(map(then.__contains__, gives)):
            for name in gives:
                values.setdefault(name, then[name])
            continue
        for name, value in zip(gives, step.run(values), strict=True):
            if name in given:
                continue
            old = then.get(name, _NOTHING)
            values[name] = old if (is_same := _is_same(value, old)) else value
            if not is_same:
                changed.add(name)
    return values


def _equals(now: Any, then: Any) -> bool:
    """Whether plain values are equal; tuples by their entries, since arrays have no truth value."""
    if now is then:
        return True
    if type(now) is not type(then) or not isinstance(now, _PLAIN):
        return False
    if isinstance(now, tuple):
        return len(now) == len(then) and all(map(_equals, now, then))
    return bool(now == then)


def _is_same(now: Any, then: Any) -> bool:
    """Whether results are equal bit by bit, within arrays, mappings and frozen values, too."""
    if now is then:
        return True
    if type(now) is not type(then):
        return False
    if isinstance(now, np.ndarray):
        alike = now.shape == then.shape and now.dtype == then.dtype and not now.dtype.hasobject
        return alike and bool(now.tobytes() == then.tobytes())
    if isinstance(now, dict):
        return list(now) == list(then) and all(_is_same(value, then[name]) for name, value in now.items())
    if isinstance(now, tuple):
        return len(now) == len(then) and all(map(_is_same, now, then))
    if is_frozen_value(now):
        names = now.__dataclass_fields__
        return all(_is_same(getattr(now, name), getattr(then, name)) for name in names)
    return now.hex() == then.hex() if isinstance(now, float) else _equals(now, then)
