"""The multiple of the identity that a Newton method adds to its Hessian in the states, by control weight."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["BOLD", "CAREFUL", "MAX_SHIFT", "Care", "first_shift", "larger_shift", "next_shift"]

MAX_SHIFT = 1e10

_GOOD_STEP = 0.2  # step length after which the shift shrinks
_FAST_CONTRACTION = 0.1  # of the residual in one full step
_FIRST, _FIRST_GROWTH = 1e-2, 30.0  # before any step has told of the size, as in [Waechter2006]


@dataclass(frozen=True)
class Care:
    """How the shift changes, and when it grows rather than that a step becomes shorter.

    Attributes
    ----------
    growth, regrowth, shrinkage : float
        Factors of the shift; the second where the Hessian is indefinite, and the size of a shift is known.
    min_step : float
        A step length below which a larger shift is tried first ...
    patience : int
        ... this many times.
    after_short : float
        What the shift is at least after a short step: a smaller one changes nothing of a step.
    """

    growth: float
    regrowth: float
    shrinkage: float
    min_step: float
    patience: int
    after_short: float = 0.0


BOLD = Care(growth=8.0, regrowth=4.0, shrinkage=3.0, min_step=0.02, patience=3, after_short=1e-2)
# Along valleys with negative curvature a shift that shrinks too far costs several short steps each time;
# smaller factors took a third fewer iterations on drones that spent hundreds there.
CAREFUL = Care(growth=3.0, regrowth=3.0, shrinkage=3.0, min_step=0.4, patience=8)


def first_shift(shift: float) -> float:
    """Next one to try where the Hessian is indefinite, and no step has had a shift yet."""
    return max(_FIRST_GROWTH * shift, _FIRST)


def larger_shift(shift: float, least: float, care: Care = BOLD) -> float:
    """Next one to try where a shift did not do; `least` is the smallest one there is, but none."""
    return max(care.growth * shift, least)


def next_shift(shift: float, length: float, contraction: float, least: float, care: Care = BOLD) -> float:
    """Where the next iteration begins, after this part of a Newton step and contraction of the residual."""
    if length < _GOOD_STEP:
        return max(2.0 * max(shift, least), care.after_short)
    if length == 1.0 and contraction < _FAST_CONTRACTION:
        return 0.0  # Newton's own convergence has set in
    return shift / care.shrinkage if shift / care.shrinkage > least else 0.0
