"""When a via point holds: a time that is given, or one that is found with the motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mbocp._numbers import is_number
from mbocp._text import shown
from mbocp.exceptions import InvalidValue, ProblemError

__all__ = ["FREE", "FreeTime", "time_from", "written_time"]

FREE = "free"
_KEYS = ("min", "max", "guess")
_SIDES = ("earliest", "latest", "guess")


@dataclass(frozen=True)
class FreeTime:
    """A time that is found with the motion.

    Attributes
    ----------
    earliest, latest : float
        Bounds of it [s]; the same where it is given after all.
    guess : float, optional
        Where the search begins [s].
    """

    earliest: float = 0.0
    latest: float = math.inf
    guess: float | None = None

    def check(self, key: str) -> None:
        """Refuse what are no times, or not in their order.

        Raises
        ------
        InvalidValue
        """
        if not (is_number(self.earliest) and 0.0 <= self.earliest < math.inf):
            raise InvalidValue(f"{key}: time.min", shown(self.earliest), "a time from the start on [s]")
        if not (is_number(self.latest) and self.latest >= self.earliest and self.latest > 0.0):
            expected = f"a time not before min = {self.earliest:g} [s], and after the start"
            raise InvalidValue(f"{key}: time.max", shown(self.latest), expected)
        if self.guess is None:
            return
        if not (is_number(self.guess) and 0.0 < self.guess < math.inf):
            raise InvalidValue(f"{key}: time.guess", shown(self.guess), "a time after the start [s]")
        if not self.earliest <= self.guess <= self.latest:
            expected = f"a time between min and max, {self.earliest:g} and {self.latest:g} s"
            raise InvalidValue(f"{key}: time.guess", self.guess, expected)


def time_from(written: Any, key: str) -> float | FreeTime | None:
    """What `via.time` says: a number [s], "free", or a table with some of min, max and guess [s].

    Raises
    ------
    ProblemError
        If it is none of them, or has other keys.
    """
    if written is None or is_number(written):
        return written
    if written == FREE:
        return FreeTime()
    if not isinstance(written, Mapping):
        raise ProblemError(
            f'{key}.time: got {shown(written)}, expected a number of seconds, "{FREE}", or a table with min, '
            "max and, if you like, guess"
        )
    stray = [name for name in written if name not in _KEYS]
    if stray:
        raise ProblemError(f"{key}.time: unknown key {stray[0]!r}; there are {', '.join(_KEYS)}")
    return FreeTime(
        **{side: written[name] for side, name in zip(_SIDES, _KEYS, strict=True) if name in written}
    )


def written_time(time: float | FreeTime | None) -> Any:
    """What reads back as the same."""
    if not isinstance(time, FreeTime):
        return time
    pairs = zip(_KEYS, (time.earliest or None, time.latest, time.guess), strict=True)
    return {key: value for key, value in pairs if value is not None and math.isfinite(value)} or FREE
