"""Durations and times as people say them: given, free between bounds, or a part of a phase."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from mbocp._arrays import dataclass
from mbocp._quantities import is_number
from mbocp._text import show
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem._checks import check_number, check_positive

FREE = "free"
_BOUNDS = ("min", "max", "guess")  # keys of a table in place of a number
_SIDES = ("earliest", "latest", "guess")
_KEY = "horizon.duration"
_LARGEST = 1e12  # [s] 30,000 years; squares of much longer ones overflow
_SMALLEST = 1e-12  # [s] squares of much shorter steps underflow
_WIDEST = 1e6  # ratio of the bounds: steps that differ more have nothing in common
_SHORTEST = 1e-3  # of the mean length of a step at the least duration: a phase takes some time


def check_duration(duration: Any, bounds: Any, key: str = _KEY) -> tuple[float, tuple[float, float] | None]:
    """Return the duration, or the guess of a free one, and the bounds of a free one [s].

    Raises
    ------
    InvalidValue
        If one is not positive, too small or too large, or they are not in order.
    """
    if bounds is None:
        return _check_time(key, duration), None
    lower, upper = (_check_time(f"{key}.{word}", side) for word, side in zip(_BOUNDS, bounds, strict=False))
    if not lower < upper <= _WIDEST * lower:
        expected = f"more than min ({lower:g} s), and at most {_WIDEST:g} times as much"
        raise InvalidValue(f"{key}.max", upper, expected)
    value = _check_time(f"{key}.guess", duration)
    if not lower <= value <= upper:
        raise InvalidValue(
            f"{key}.guess", value, f"a duration between min and max, {lower:g} and {upper:g} s"
        )
    return value, (lower, upper)


def _check_time(key: str, value: Any) -> float:
    seconds = check_positive(key, value, "s")
    if not _SMALLEST <= seconds <= _LARGEST:
        expected = f"a positive number [s] of at least {_SMALLEST:g} and of at most {_LARGEST:g}"
        raise InvalidValue(key, seconds, expected)
    return seconds


def least_time(count: int, num_steps: int, duration: float) -> float:
    """Return the least time [s] of a phase of some of the steps, of which all take at least `duration`."""
    return _SHORTEST * count * duration / num_steps


def duration_from(written: Any, key: str = _KEY) -> dict[str, Any]:
    """Return `duration` and `duration_range` of a problem, or of a phase, from what the key says.

    Without a guess it is the geometric mean of the bounds.

    Raises
    ------
    ProblemError
        If a table has other keys than min, max and guess, or lacks one of the bounds.
    """
    if not isinstance(written, Mapping):
        return {"duration": written, "duration_range": None}
    stray = [word for word in written if word not in _BOUNDS]
    missing = [word for word in _BOUNDS[:2] if written.get(word) is None]
    if stray or missing:
        what = f"unknown key {stray[0]!r}" if stray else f"{missing[0]} is missing"
        raise ProblemError(f"{key}: {what}; give a number, or a table with min, max and, if you like, guess")
    lower, upper = (check_number(f"{key}.{word}", written[word]) for word in _BOUNDS[:2])
    guess = written.get("guess")
    if guess is None:
        guess = math.sqrt(max(lower, 0.0) * max(upper, 0.0)) or lower
    return {"duration": guess, "duration_range": (lower, upper)}


def write_duration(duration: float, bounds: tuple[float, float] | None) -> float | dict[str, float]:
    """Return what reads back as the same."""
    return duration if bounds is None else dict(zip(_BOUNDS, (*bounds, duration), strict=True))


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
            raise InvalidValue(f"{key}: time.min", show(self.earliest), "a time from the start on [s]")
        if not (is_number(self.latest) and self.latest >= self.earliest and self.latest > 0.0):
            expected = f"a time not before min = {self.earliest:g} [s], and after the start"
            raise InvalidValue(f"{key}: time.max", show(self.latest), expected)
        if self.guess is None:
            return
        if not (is_number(self.guess) and 0.0 < self.guess < math.inf):
            raise InvalidValue(f"{key}: time.guess", show(self.guess), "a time after the start [s]")
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
            raise InvalidValue(f"{key}: time.share", show(self.share), expected)


def time_from(written: Any, key: str) -> float | FreeTime | InPhase | None:
    """Read `via.time`: a number [s], "free", bounds [s], the name of a phase, or a part of one.

    Raises
    ------
    ProblemError
        If it is none of them, or has other keys.
    """
    if written is None or is_number(written):
        return written
    if isinstance(written, str):
        return FreeTime() if written == FREE else InPhase(written)
    if not isinstance(written, Mapping):
        raise ProblemError(
            f'{key}.time: got {show(written)}, expected a number of seconds, "{FREE}", the name of a phase, '
            "or a table with min, max and, if you like, guess"
        )
    return _part_from(written, key) if "phase" in written else _free_from(written, key)


def _part_from(written: Mapping[str, Any], key: str) -> InPhase:
    if set(written) - {"phase", "share"} or not isinstance(written["phase"], str):
        raise ProblemError(f"{key}.time: got {show(written)}, expected {{ phase = name, share = number }}")
    return InPhase(written["phase"], written.get("share", 1.0))


def _free_from(written: Mapping[str, Any], key: str) -> FreeTime:
    stray = [name for name in written if name not in _BOUNDS]
    if stray:
        raise ProblemError(f"{key}.time: unknown key {stray[0]!r}; there are {', '.join(_BOUNDS)}")
    pairs = zip(_SIDES, _BOUNDS, strict=True)
    return FreeTime(**{side: written[name] for side, name in pairs if name in written})


def write_time(time: float | FreeTime | InPhase | None) -> Any:
    """Return what reads back as the same."""
    if isinstance(time, InPhase):
        return {"phase": time.name, "share": time.share}
    if not isinstance(time, FreeTime):
        return time
    pairs = zip(_BOUNDS, (time.earliest or None, time.latest, time.guess), strict=True)
    return {key: value for key, value in pairs if value is not None and math.isfinite(value)} or FREE
