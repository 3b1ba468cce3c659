"""The multiple of the identity that a Newton method adds to its Hessian in the states, by control weight."""

from __future__ import annotations

__all__ = ["MAX_SHIFT", "larger_shift", "next_shift"]

MAX_SHIFT = 1e10

_GROWTH, _SHRINKAGE = 8.0, 5.0
_GOOD_STEP = 0.2  # step length after which the shift shrinks
_FAST_CONTRACTION = 0.1  # of the residual in one full step


def larger_shift(shift: float, least: float) -> float:
    """Next one to try where a shift did not do; `least` is the smallest one there is, but none."""
    return max(_GROWTH * shift, least)


def next_shift(shift: float, length: float, contraction: float, least: float) -> float:
    """Where the next iteration begins, after a step of this length and contraction of the residual."""
    if length < _GOOD_STEP:
        return 2.0 * max(shift, least)
    if length == 1.0 and contraction < _FAST_CONTRACTION:
        return 0.0  # Newton's own convergence has set in
    return shift / _SHRINKAGE if shift / _SHRINKAGE > least else 0.0
