r"""Barrier parameters that steps choose themselves while that goes well, [Mehrotra1992]_, [Nocedal2009]_.

*Free parameters.* The step with no barrier at all, of the factors at hand, says what it would leave of the
products of multipliers and distances. The cube of that part, of their mean, is the parameter mu of the step
that is taken. Where the step without a barrier is not cut too short, what its parts in distances and in
multipliers come to together is made up for, too, by another right-hand side of the same factors.

*Fixed parameters.* Nothing makes such a sequence converge. At the first sign of trouble, a residual that does
not fall or a step that is hardly one, mu is fixed at the largest of the last ones, or near the mean of all
products if that is larger, and falls as `mbocp.solvers.newton_method.limits` has it. When Newton's full steps
have brought the residual below all that was reached with free parameters, these are tried once more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbocp.programme.native import KernelFilter

_MEMORY = 4  # residuals, of which the next one has to be below the largest ...
_PROGRESS = 0.9999  # ... times this ...
_GROWTH = 100.0  # ... and below the smallest times this
_RETURNS = 1  # to free parameters, after which they stay fixed
_POWER = 3.0  # of the part of the products that a step without barrier leaves
_OF_ERROR = 1e-4  # of the defects of the barrier problem: products that are far smaller leave the centre ...
_LEAST_STEP = 0.1  # without barrier, that is worth making up for: beyond a shorter one products are no guide
_OF_MEAN = 0.8  # of all products: the least parameter that begins where they are fixed


@dataclass(frozen=True)
class Centring:
    """Whether barrier parameters are free, to be chosen by each step, and how that has gone.

    Attributes
    ----------
    first : float
        Barrier parameter of the guess.
    bounds : Filter
        The filter of the guess. What it says of the violation holds for all free parameters: bounds that rose
        with each new one would be none.
    is_free : bool
    residuals, barriers : tuple of float
        The last residuals that were reached with free parameters, and these.
    num_fixed : int
        How often parameters have been fixed.
    """

    first: float
    bounds: KernelFilter
    is_free: bool = True
    residuals: tuple[float, ...] = ()
    barriers: tuple[float, ...] = ()
    num_fixed: int = 0

    def update(self, residual: float, barrier: float, *, is_newtons: bool) -> Centring:
        """What a residual, reached with a barrier parameter, says of the parameters to come.

        `is_newtons`: with a full step without a shift.
        """
        if self.is_free and self._is_progress(residual):
            residuals, barriers = (*self.residuals, residual), (*self.barriers, barrier)
            return replace(self, residuals=residuals[-_MEMORY:], barriers=barriers[-_MEMORY:])
        if self.is_free:
            return self.fix()
        if is_newtons and self.num_fixed <= _RETURNS and residual < min(self.residuals):
            return replace(self, is_free=True, residuals=(residual,), barriers=(barrier,))
        return self

    def fix(self) -> Centring:
        """The same with fixed parameters."""
        return replace(self, is_free=False, num_fixed=self.num_fixed + 1)

    def fixed_barrier(self, mean: float) -> float:
        """Barrier parameter to begin with where it is fixed; `mean` of all products."""
        return max(*self.barriers, _OF_MEAN * mean)

    def least_barrier(self, error: float) -> float:
        """Least free parameter where the conditions of the barrier problem have this defect."""
        return min(self.first, _OF_ERROR * error)

    def _is_progress(self, residual: float) -> bool:
        if self.residuals and residual > _GROWTH * min(self.residuals):
            return False
        return len(self.residuals) < _MEMORY or residual <= _PROGRESS * max(self.residuals)


def aimed_barrier(mean: float, foreseen: float) -> float:
    """Barrier parameter of a step; `foreseen` is the mean of all products after a step without barrier."""
    share = max(0.0, foreseen / mean) if mean > 0.0 else 0.0
    return mean * min(1.0, math.pow(share, _POWER))


def may_correct(longest: float) -> bool:
    """Whether to make up for the products of a step without barrier, of which limits allow that part."""
    return longest >= _LEAST_STEP
