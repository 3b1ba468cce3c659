"""How short a phase may become."""

from __future__ import annotations

_SHORTEST = 1e-3  # of the mean length of a step at the least duration: a phase takes some time


def least_time(count: int, num_steps: int, duration: float) -> float:
    """Least time [s] of a phase of some of the steps, of which all take at least `duration` [s]."""
    return _SHORTEST * count * duration / num_steps
