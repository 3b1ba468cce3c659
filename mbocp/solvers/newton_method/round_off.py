r"""What round-off leaves of residual and increment where the numbers of a problem are large.

A row of the optimality conditions is a sum of terms that cancel at a solution. Its value cannot be brought
below round-off of the largest of them. In the stationarity conditions these are of the size of the
multipliers, in the state equations of the size of states and controls:

.. math:: \epsilon_d = 8\, \epsilon\, \|(\mu, \Delta t\, \zeta, \eta, z)\|, \qquad
          \epsilon_p = 8\, \epsilon\, \|(x, u)\|, \qquad \epsilon = 2^{-52}

Where neither is above the tolerance, which takes numbers above 5e5, the tolerance is all that counts. Where
one is, it stands for the tolerance in its part of the residual, and increments count relative to the unknowns
they belong to.

Where coefficients are large, too, terms are larger than the multipliers and the states: a chain of light
links multiplies them by hundreds. What they come to shows in a residual whose unknowns are all moved by a
small part of themselves, with random signs: it grows by that part of the root of its terms' squares. Two
evaluations tell it, which is why it is asked only where steps have led no farther.

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
    from mbocp.programme.native import KernelProgramme

_ROUND_OFF = 8.0 * 2.0**-52
# Of terms: each is what hundreds of operations on links come to, and all of them round. Chains of 8 and 16
# links leave between 0.5 and 120 times the machine's precision.
_ROUND_OFF_OF_TERMS = 256.0 * 2.0**-52
_MOVED = 2.0**-36  # of the unknowns: far above round-off, and so little that all is linear in it
_UNKNOWNS = ("x", "y", "u", "m", "eta")
_OF_GRADIENT = 1e-4  # of the cost: what may be left of stationarity, however large multipliers are


def round_off(native: KernelProgramme) -> tuple[float, float]:
    """What round-off may leave of the primal and of the dual part of the residual."""
    sizes = native.sizes()
    return _ROUND_OFF * sizes.primal, _ROUND_OFF * sizes.dual


def round_off_of_terms(native: KernelProgramme, evaluation: Norms) -> tuple[float, float]:
    """The same from the terms themselves: what either may leave, whichever is larger.

    Parameters
    ----------
    native : kernel programme
        It is evaluated again as it was.
    evaluation : kernel Evaluation
        At its iterate.
    """
    kept, rng = Kept.of(native), np.random.default_rng(0)
    for name in _UNKNOWNS:
        values = getattr(native, name)
        setattr(native, name, values * (1.0 + _MOVED * rng.choice([-1.0, 1.0], values.shape)))
    moved = native.evaluate()
    kept.restore(native)
    native.evaluate()
    primal, dual = round_off(native)
    share = _ROUND_OFF_OF_TERMS / _MOVED
    return (
        max(primal, share * _growth(evaluation.primal, moved.primal)),
        max(dual, share * _growth(evaluation.dual, moved.dual)),
    )


def _growth(before: float, after: float) -> float:
    """Norm of what was added to a vector, at a right angle as random signs have it."""
    return math.sqrt(max(0.0, after**2 - before**2)) if math.isfinite(after) else 0.0


def relative_residual(allowed: tuple[float, float], evaluation: Norms, tolerance: float) -> float:
    """The residual, each part in units of its round-off by `tolerance` where that is above the tolerance."""
    primal, dual = (max(1.0, size / tolerance) for size in allowed)
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
