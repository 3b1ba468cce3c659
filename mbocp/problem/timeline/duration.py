"""How long the horizon is: a number, or free between bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem._checks import check_number, check_positive

KEYS = ("min", "max", "guess")  # of the table `horizon.duration`
_KEY = "horizon.duration"
_LARGEST = 1e12  # [s] 30,000 years; squares of much longer ones overflow
_SMALLEST = 1e-12  # [s] squares of much shorter steps underflow
_WIDEST = 1e6  # ratio of the bounds: steps that differ more have nothing in common


def check_duration(duration: Any, bounds: Any, key: str = _KEY) -> tuple[float, tuple[float, float] | None]:
    """Duration, the guess of a free one, and the bounds of a free one [s], checked.

    Raises
    ------
    InvalidValue
        If one is not positive, too small or too large, or they are not in order.
    """
    if bounds is None:
        return _checked(key, duration), None
    lower, upper = (_checked(f"{key}.{word}", side) for word, side in zip(KEYS, bounds, strict=False))
    if not lower < upper <= _WIDEST * lower:
        expected = f"more than min ({lower:g} s), and at most {_WIDEST:g} times as much"
        raise InvalidValue(f"{key}.max", upper, expected)
    value = _checked(f"{key}.guess", duration)
    if not lower <= value <= upper:
        raise InvalidValue(
            f"{key}.guess", value, f"a duration between min and max, {lower:g} and {upper:g} s"
        )
    return value, (lower, upper)


def _checked(key: str, value: Any) -> float:
    seconds = check_positive(key, value, "s")
    if not _SMALLEST <= seconds <= _LARGEST:
        expected = f"a positive number [s] of at least {_SMALLEST:g} and of at most {_LARGEST:g}"
        raise InvalidValue(key, seconds, expected)
    return seconds


def duration_from(written: Any, key: str = _KEY) -> dict[str, Any]:
    """Fields `duration` and `duration_range` of a problem, or of a phase, from what the key says.

    Without a guess it is the geometric mean of the bounds.

    Raises
    ------
    ProblemError
        If a table has other keys than min, max and guess, or lacks one of the bounds.
    """
    if not isinstance(written, Mapping):
        return {"duration": written, "duration_range": None}
    stray = [word for word in written if word not in KEYS]
    missing = [word for word in KEYS[:2] if written.get(word) is None]
    if stray or missing:
        what = f"unknown key {stray[0]!r}" if stray else f"{missing[0]} is missing"
        raise ProblemError(f"{key}: {what}; give a number, or a table with min, max and, if you like, guess")
    lower, upper = (check_number(f"{key}.{word}", written[word]) for word in KEYS[:2])
    guess = written.get("guess")
    if guess is None:
        guess = math.sqrt(max(lower, 0.0) * max(upper, 0.0)) or lower
    return {"duration": guess, "duration_range": (lower, upper)}


def written_duration(duration: float, bounds: tuple[float, float] | None) -> float | dict[str, float]:
    """What reads back as the same."""
    return duration if bounds is None else dict(zip(KEYS, (*bounds, duration), strict=True))
