"""Values that follow from each other, step by step; what has not changed is not worked out again.

A step is a function whose parameters are names of values. It returns the values that it gives. A check gives
none.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePath
from typing import Any

from mbocp._dataclass import dataclass

_PLAIN = (int, float, str, bool, tuple, type(None), PurePath)  # compared by value; all else by identity


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

    def run(self, values: Mapping[str, Any], before: Mapping[str, Any]) -> dict[str, Any]:
        """Return what it gives for these values: what it gave before, if it took the same then."""
        if before and self._takes_same(values, before):
            return {name: before[name] for name in self.gives}
        result = self.work(*(values[name] for name in self.takes))
        made = (result,) if len(self.gives) == 1 else result if self.gives else ()
        return dict(zip(self.gives, made, strict=True))

    def _takes_same(self, values: Mapping[str, Any], before: Mapping[str, Any]) -> bool:
        """Whether it gave something before, and took the same; asked of each step of each change."""
        for name in self.takes:
            now, then = values[name], before.get(name, self)
            if now is not then and not _equals(now, then):
                return False
        return all(name in before for name in self.gives)


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
    values = dict(given)
    for step in steps:
        if not step.gives or any(name not in given for name in step.gives):
            made = step.run(values, before or {})
            values.update((name, value) for name, value in made.items() if name not in given)
    return values


def _equals(now: Any, then: Any) -> bool:
    """Whether plain values are equal; tuples by their entries, since arrays have no truth value."""
    if type(now) is not type(then) or not isinstance(now, _PLAIN):
        return False
    if isinstance(now, tuple):
        pairs = zip(now, then, strict=False)
        return len(now) == len(then) and all(a is b or _equals(a, b) for a, b in pairs)
    return bool(now == then)
