"""From what a file says to a float, in one place: numbers and nothing else, finite, whatever their length."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeGuard

from mbocp._quantities import Quantity
from mbocp._text import show

LARGEST = 1e100  # of numbers in files: squares and cubes of them are floats, too


def is_number(value: Any) -> TypeGuard[int | float]:
    """Whether `value` is an int or a float; booleans are not."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def as_float(value: int | float) -> float:
    """Return the nearest float, or a quantity as it is; infinite for an integer beyond all of them."""
    if isinstance(value, Quantity):
        return value
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def finite_number(value: Any, where: str = "") -> float:
    """Return `value` as a float of at most `LARGEST`, either sign.

    Raises
    ------
    ValueError
        Saying what was got, and `where`, for pydantic to collect.
    """
    if not is_number(value):
        raise ValueError(f"got {show(value)}{where}, expected a number")
    number = as_float(value)
    if not math.isfinite(number):
        raise ValueError(f"got {show(value)}{where}, expected a finite number")
    if abs(number) > LARGEST:
        raise ValueError(f"got {show(value)}{where}, expected a number of at most {LARGEST:g}")
    return number


def vector(value: Any, where: str = "") -> list[float]:
    """Finite numbers of a list."""
    return [finite_number(entry, f" at index {i}{where}") for i, entry in enumerate(value)]


def named_numbers(value: Mapping[str, Any]) -> dict[str, float | list[float]]:
    """Finite numbers, or lists of them, by name."""
    return {
        name: vector(entry, f" for {show(name)}")
        if isinstance(entry, list)
        else finite_number(entry, f" for {show(name)}")
        for name, entry in value.items()
    }
