"""What the environment says: numbers that its variables set, and processors."""

from __future__ import annotations

import math
import os
import sys

from mbocp.exceptions import InvalidValue


def number_from(
    name: str, expected: str, *, may_be_zero: bool = False, below: float = math.inf
) -> float | None:
    """Return the number in an environment variable; None where it is not set, or empty.

    Parameters
    ----------
    name : str
    expected : str
        What it should be, for the message.
    may_be_zero : bool
        Else it is above zero.
    below : float
        It is less than that, if that is finite.

    Raises
    ------
    InvalidValue
        If it is no such number.
    """
    text = os.environ.get(name)
    if not text:
        return None
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    is_right = (number >= 0.0 if may_be_zero else number > 0.0) and (math.isinf(below) or number < below)
    if not is_right:
        raise InvalidValue(name, repr(text), expected)
    return number


def available_workers() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def available_threads() -> int:
    """Number of processors that one task may take: 1 where this process is a worker among others."""
    processes = sys.modules.get("multiprocessing.process")  # imported where this is one of its processes
    is_worker = processes is not None and processes.parent_process() is not None
    return 1 if is_worker else available_workers()
