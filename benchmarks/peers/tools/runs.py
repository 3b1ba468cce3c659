"""What a solver hands back, and how all of them are timed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from benchmarks.peers.task import Array

__all__ = ["NotSolved", "Run", "timed"]

T = TypeVar("T")
_LONG = 20.0  # [s]: of what takes longer together there are no more repetitions


class NotSolved(Exception):
    """The solver cannot take the problem, or ends without a solution; says why."""


@dataclass(frozen=True, eq=False)
class Run:
    """Trajectory, iterations and wall times [s]."""

    qs: Array
    vs: Array
    us: Array
    iterations: int
    seconds: list[float]
    remark: str = ""


def timed(
    work: Callable[[], T], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> tuple[T, list[float]]:
    """Result of the last of several calls, and the time of each but the first, which warms up."""
    seconds: list[float] = []
    for _ in range(repeats + 1):
        begun = clock()
        result = work()
        seconds.append(clock() - begun)
        if sum(seconds) > _LONG:
            break
    return result, seconds[1:] or seconds
