"""When a via point holds: a time that is given, one that is found with the motion, or a place in a phase."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mbocp._numbers import is_number
from mbocp._text import shown
from mbocp.exceptions import InvalidValue, ProblemError

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


@dataclass(frozen=True)
class InPhase:
    """A node of a phase.

    Attributes
    ----------
    name : str
        Of the phase.
    share : float
        Part of its steps that leads there: 1 at its end.
    """

    name: str
    share: float = 1.0

    def check(self, key: str) -> None:
        """Refuse what is no part.

        Raises
        ------
        InvalidValue
        """
        if not (is_number(self.share) and 0.0 <= self.share <= 1.0):
            expected = "a part of the phase, 0 <= share <= 1"
            raise InvalidValue(f"{key}: time.share", shown(self.share), expected)


def time_from(written: Any, key: str) -> float | FreeTime | InPhase | None:
    """What `via.time` says: a number [s], "free", bounds [s], the name of a phase, or a part of one.

    Raises
    ------
    ProblemError
        If it is none of them, or has other keys.
    """
    if written is None or is_number(written):
        return written
    if written == FREE:
        return FreeTime()
    if isinstance(written, str):
        return InPhase(written)
    if not isinstance(written, Mapping):
        raise ProblemError(
            f'{key}.time: got {shown(written)}, expected a number of seconds, "{FREE}", the name of a phase, '
            "or a table with min, max and, if you like, guess"
        )
    if "phase" in written:
        stray = [name for name in written if name not in ("phase", "share")]
        if stray or not isinstance(written["phase"], str):
            raise ProblemError(
                f"{key}.time: got {shown(written)}, expected {{ phase = name, share = number }}"
            )
        return InPhase(written["phase"], written.get("share", 1.0))
    stray = [name for name in written if name not in _KEYS]
    if stray:
        raise ProblemError(f"{key}.time: unknown key {stray[0]!r}; there are {', '.join(_KEYS)}")
    return FreeTime(
        **{side: written[name] for side, name in zip(_SIDES, _KEYS, strict=True) if name in written}
    )


def written_time(time: float | FreeTime | InPhase | None) -> Any:
    """What reads back as the same."""
    if isinstance(time, InPhase):
        return {"phase": time.name, "share": time.share}
    if not isinstance(time, FreeTime):
        return time
    pairs = zip(_KEYS, (time.earliest or None, time.latest, time.guess), strict=True)
    return {key: value for key, value in pairs if value is not None and math.isfinite(value)} or FREE
