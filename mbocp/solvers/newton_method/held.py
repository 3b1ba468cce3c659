"""A solution with its active limits held: what it does when the start or the parameters change a little.

As long as no other limits become active, an optimum within limits is one of the same problem in which the
active limits are equations, and the others are none.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.programme.kernel import kernel_programme
from mbocp.solvers.newton_method.limits import bounded_values, multipliers_in_rows, why_limits_cannot_be_kept

if TYPE_CHECKING:
    from mbocp.programme.native import KernelProgramme

_GRAIN = 8 * 2.0**-52  # of a bound: distances below it are round-off
_ANY = 1.0  # barrier parameter: equations have none


def hold_active_limits(
    programme: StagewiseProgramme, iterate: Iterate
) -> tuple[KernelProgramme, BoolArray] | None:
    """Kernel programme at a solution with its active limits as equations, evaluated; and which these are.

    A limit is active where its multiplier is larger than the force on a control that is as far from its
    optimum as the motion is from the limit. Guards of the end condition are left out: no solution touches
    them.

    Parameters
    ----------
    programme : StagewiseProgramme
    iterate : Iterate
        Its solution, with the multipliers of limits.

    Returns
    -------
    native : KernelProgramme
    held : ndarray of bool, shape (N, nx + nu + nh)
        Limits that are held, of states, controls and path functions.

    Or None, where functions are not finite, or no programme of the kernel keeps the limits.
    """
    if why_limits_cannot_be_kept(programme):
        return None
    bounds = programme.bounds
    pulls, distances = np.zeros(bounds.limited.shape), np.full(bounds.limited.shape, np.inf)
    if iterate.bounds is not None and not bounds.is_empty:
        plain = replace(programme, num_guards=0)
        pulls[bounds.limited] = multipliers_in_rows(iterate.bounds, plain)[: np.count_nonzero(bounds.limited)]
        distances = _distances(plain, iterate, pulls)
    held = (np.abs(pulls) > programme.control_weight * distances) | bounds.are_equations
    sides = np.where(pulls > 0.0, bounds.upper, bounds.lower)
    fixed = replace(
        programme,
        num_guards=0,
        bounds=bounds.with_sides(np.where(held, sides, -np.inf), np.where(held, sides, np.inf)),
    )
    native = kernel_programme(fixed, has_limits=bool(held.any()))
    iterate.load_into(native)
    if held.any():
        native.start_limits(_ANY)
        native.z_upper = pulls[held]
    return (native, held) if native.evaluate().finite else None


def _distances(programme: StagewiseProgramme, iterate: Iterate, pulls: Array) -> Array:
    """How far limits are from the motion, on the side that pulls; infinite where there are none."""
    bounds, values = programme.bounds, bounded_values(programme, iterate)
    of_side = np.where(pulls > 0.0, bounds.upper - values, values - bounds.lower)
    grain = _GRAIN * np.maximum(1.0, np.abs(values))
    return np.where(bounds.limited, np.maximum(of_side, grain), np.inf)
