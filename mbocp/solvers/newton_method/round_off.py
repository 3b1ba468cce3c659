r"""What round-off leaves of residual and increment where the numbers of a problem are large.

A row of the optimality conditions is a sum of terms that cancel at a solution. Its value cannot be brought
below round-off of the largest of them. In the stationarity conditions these are of the size of the
multipliers, in the state equations of the size of states and controls:

.. math:: \epsilon_d = 8\, \epsilon\, \|(\mu, \Delta t\, \zeta, \eta, z)\|, \qquad
          \epsilon_p = 8\, \epsilon\, \|(x, u)\|, \qquad \epsilon = 2^{-52}

Where neither is above the tolerance, which takes numbers above 5e5, the tolerance is all that counts. Where
one is, it stands for the tolerance in its part of the residual, and increments count relative to the unknowns
they belong to.

At a singular configuration multipliers may grow without bound, until all that is left of stationarity is
round-off, and the cost has no say any more. So what is left has to be small beside the gradient of the cost,
too.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array
from mbocp._linear import norm
from mbocp.solvers.protocol import Norms
from mbocp.solvers.staggered.sweep import Kept

if TYPE_CHECKING:
    from mbocp.programme.kernel import KernelProgramme

__all__ = ["has_a_say", "relative_increment", "relative_residual", "round_off"]

_ROUND_OFF = 8.0 * 2.0**-52
_OF_GRADIENT = 1e-4  # of the cost: what may be left of stationarity, however large multipliers are


def round_off(native: KernelProgramme) -> tuple[float, float]:
    """What round-off may leave of the primal and of the dual part of the residual."""
    sizes = native.sizes()
    return _ROUND_OFF * sizes.primal, _ROUND_OFF * sizes.dual


def relative_residual(native: KernelProgramme, evaluation: Norms, tolerance: float) -> float:
    """The residual, each part in units of its round-off by `tolerance` where that is above the tolerance."""
    primal, dual = (max(1.0, size / tolerance) for size in round_off(native))
    return math.hypot(evaluation.primal / primal, evaluation.dual / dual)


def has_a_say(native: KernelProgramme, evaluation: Norms) -> bool:
    """Whether what is left of stationarity is small beside the gradient of the cost."""
    kept = Kept.of(native)
    native.m, native.eta = np.zeros_like(native.m), np.zeros_like(native.eta)
    native.z_lower, native.z_upper = np.zeros_like(native.z_lower), np.zeros_like(native.z_upper)
    gradient = native.evaluate().dual
    kept.restore(native)
    native.evaluate()
    return bool(evaluation.dual <= _OF_GRADIENT * gradient)


def relative_increment(native: KernelProgramme) -> float:
    """The last direction, each kind of unknowns relative to its own norm where that is above one."""
    pairs = (
        ((native.dx,), (native.x,)),
        ((native.dy, native.du), (native.y, native.u)),
        ((native.dm, native.deta), (native.m, native.eta)),
    )
    return math.hypot(*(_norm(*step) / max(1.0, _norm(*unknowns)) for step, unknowns in pairs))


def _norm(*parts: Array) -> float:
    return math.hypot(*(norm(part.ravel()) for part in parts))
