"""When a path constraint holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import create_model

from mbocp._arrays import BoolArray
from mbocp._numbers import is_number
from mbocp._text import shown
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.terms.written import Finite, Table

__all__ = ["SPAN", "Span", "SpanKeys"]

_GRAIN = 1e-6  # of a step: times closer to a node than this are the node's


SPAN = ("from", "until")  # its keys in a problem file
_FIELDS: Any = dict.fromkeys(SPAN, (Finite | None, None))
SpanKeys = create_model("SpanKeys", __base__=Table, __doc__="When a path constraint holds.", **_FIELDS)


@dataclass(frozen=True)
class Span:
    """A part of the horizon, both ends included.

    Attributes
    ----------
    since, until : float or None
        [s]; None: the start, and the end of the motion.
    """

    since: float | None = None
    until: float | None = None

    @property
    def has_start(self) -> bool:
        """Whether the start belongs to it."""
        return self.since is None or self.since == 0.0

    def has_end(self, num_steps: int, dt: float) -> bool:
        """Whether the last node belongs to it."""
        return bool(self.nodes(num_steps, dt)[-1])

    @classmethod
    def read(cls, table: Table) -> Span:
        """From a table that has its keys."""
        return cls(*(getattr(table, key) for key in SPAN))

    def write(self) -> dict[str, float]:
        """Keys that read back as the same."""
        pairs = zip(SPAN, (self.since, self.until), strict=True)
        return {key: time for key, time in pairs if time is not None}

    def nodes(self, num_steps: int, dt: float) -> BoolArray:
        """Which of the nodes 1..N belong to it, shape (N,)."""
        n = np.arange(1, num_steps + 1, dtype=np.float64)
        first = -np.inf if self.since is None else self.since / dt - _GRAIN
        last = np.inf if self.until is None else self.until / dt + _GRAIN
        found: BoolArray = (n >= first) & (n <= last)
        return found

    def check(self, key: str) -> None:
        """Refuse what are no times in their order.

        Raises
        ------
        InvalidValue
            If one is no number of seconds from the start, or the second is before the first.
        """
        for name, time in (("from", self.since), ("until", self.until)):
            if time is not None and not (is_number(time) and np.isfinite(time) and time >= 0.0):
                raise InvalidValue(f"{key}: {name}", shown(time), "a time from the start on [s], at least 0")
        if self.since is not None and self.until is not None and self.until < self.since:
            raise InvalidValue(f"{key}: until", self.until, f"a time not before from = {self.since:g} [s]")

    def check_horizon(self, key: str, num_steps: int, dt: float, *, is_free: bool) -> None:
        """Refuse times outside a horizon, those between which it has no node, and any where it is free.

        Raises
        ------
        InvalidValue, ProblemError
        """
        duration = num_steps * dt
        if is_free and self != Span():
            raise ProblemError(
                f"{key}: from and until are times of a given duration, and this one is free; leave them out, "
                "or give horizon.duration as a number"
            )
        for name, time in (("from", self.since), ("until", self.until)):
            if time is not None and time > duration + _GRAIN * dt:
                raise InvalidValue(f"{key}: {name}", time, f"a time within the horizon of {duration:g} s")
        if not self.nodes(num_steps, dt).any():
            since, until = self.since or 0.0, duration if self.until is None else self.until
            raise ProblemError(
                f"{key}: no node after the start is between from = {since:g} and until = {until:g} s; nodes "
                f"are {dt:g} s apart: take times farther apart, or those of a node"
            )
