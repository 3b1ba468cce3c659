"""What a loop is given while it runs: nothing is raised, and words say what cannot be."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue
from mbocp.problem._checks import check_integer

MICROSECOND = 1e-6  # [s]
MOST_ITERATIONS = 1_000_000  # of one step: more are a mistake, and take minutes


def numbers_of(name: str, value: Any, size: int, wrong: list[str]) -> Array | None:
    """Return finite numbers of shape (size,), no copy of an array; else None, and words."""
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        wrong.append(f"{name}: not an array of numbers")
        return None
    if numbers.shape != (size,):
        wrong.append(f"{name}: got shape {numbers.shape}, expected ({size},)")
    elif np.count_nonzero(np.isfinite(numbers)) < size:
        wrong.append(f"{name}: not finite")
    else:
        return numbers
    return None


def time_of(name: str, value: Any, default: float, unit: str, wrong: list[str]) -> float:
    """Return a time of zero or more, without end where the default is; else the default, and words."""
    try:
        time = default if value is None else float(value)
    except (TypeError, ValueError, OverflowError):
        time = -1.0
    if 0.0 <= time <= max(default, sys.float_info.max):
        return time
    wrong.append(f"{name}: got {value}, expected a time >= 0 [{unit}]")
    return default


def iterations_of(value: Any, default: int, wrong: list[str]) -> int:
    """Return how many Newton steps one step may take; else the default, and words."""
    try:
        return default if value is None else check_integer("iterations", value, 0, MOST_ITERATIONS)
    except InvalidValue as error:
        wrong.append(str(error))
        return default
