"""A solution with its active limits held: what it does when the start or the parameters change a little.

As long as no other limits become active, an optimum within limits is one of the same problem in which the
active limits are equations, and the others are none.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.programme.kernel import kernel_programme, set_bounds
from mbocp.solvers.newton_method.limit_multipliers import compute_bounded_values, multipliers_in_rows

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelProgramme

_GRAIN = 8 * 2.0**-52  # of a bound: distances below it are round-off
FIRST_WEIGHT, _LAST_WEIGHT = 1e1, 1e9  # of the end condition, by the weight of the controls
# The same where gains are asked for. First gains are 2e-4 off differences of optima, 6 % in least time; with
# 10 they are 60 % off, and above 1e9 round-off shows.
GAIN_WEIGHT = 1e7
_ANY = 1.0  # barrier parameter: equations have none


def active_limits(
    programme: StagewiseProgramme, iterate: Iterate, stiffness: float = 1.0
) -> tuple[Array, BoolArray, Array]:
    """Multipliers of all limits, which are active, and the sides at which they are.

    A limit is active where its multiplier is larger than `stiffness` times the force on a control that is
    as far from its optimum as the motion is from the limit.

    Returns
    -------
    pulls : ndarray, shape (N, nx + nu + nh)
        Positive at an upper bound.
    held : ndarray of bool, shape (N, nx + nu + nh)
    sides : ndarray, shape (N, nx + nu + nh)
        Of those that are not active any.
    """
    bounds = programme.bounds
    pulls, distances = np.zeros(bounds.has_limit.shape), np.full(bounds.has_limit.shape, np.inf)
    if iterate.bounds is not None and not bounds.is_empty:
        count = np.count_nonzero(bounds.has_limit)
        pulls[bounds.has_limit] = multipliers_in_rows(iterate.bounds, programme)[:count]
        distances = _distances(programme, iterate, pulls)
    held = (np.abs(pulls) > stiffness * programme.control_weight * distances) | bounds.are_equations
    return pulls, held, np.where(pulls > 0.0, bounds.upper, bounds.lower)


def hold(
    programme: StagewiseProgramme, iterate: Iterate, pulls: Array, held: BoolArray, sides: Array
) -> KernelProgramme:
    """Kernel programme at an iterate with some limits as equations, and no others; see `active_limits`."""
    native = kernel_programme(programme)
    iterate.load_into(native)
    if held.any():
        nx, num_known = programme.kind.nx, programme.kind.nx + programme.kind.nu
        parts = (("x", slice(nx)), ("u", slice(nx, num_known)), ("path", slice(num_known, None)))
        lower, upper = np.where(held, sides, -np.inf), np.where(held, sides, np.inf)
        bounds = dict[str, Array]()
        for what, at in parts:
            bounds[f"{what}_lower"], bounds[f"{what}_upper"] = lower[:, at].ravel(), upper[:, at].ravel()
        set_bounds(native, programme, bounds, num_guards=0)
        native.start_limits(_ANY)
        native.z_upper = pulls[held]
    return native


def factorise_held(
    native: KernelProgramme,
    programme: StagewiseProgramme,
    *,
    shifts: Sequence[float] = (0.0,),
    first: float = FIRST_WEIGHT,
) -> bool:
    """Whether some weight of the end condition, and some shift, give the signs of a minimum.

    How much limits that are held have to weigh the kernel learns first. Shifts of the Hessian in the states,
    and the first weight of the end condition, are by the weight of the controls.
    """
    unit = programme.control_weight / programme.dt
    if len(native.z_upper):
        native.learn()
    for shift in shifts:
        weight = first
        while weight <= _LAST_WEIGHT:
            weights = (shift * programme.control_weight, weight * unit if programme.ng else 0.0)
            found = native.factorise(*weights)
            if found.ok and found.negative == programme.ng:
                return True
            weight *= 100.0
    return False


def _distances(programme: StagewiseProgramme, iterate: Iterate, pulls: Array) -> Array:
    """How far limits are from the motion, on the side that pulls; infinite where there are none."""
    bounds, values = programme.bounds, compute_bounded_values(programme, iterate)
    of_side = np.where(pulls > 0.0, bounds.upper - values, values - bounds.lower)
    grain = _GRAIN * np.maximum(1.0, np.abs(values))
    return np.where(bounds.has_limit, np.maximum(of_side, grain), np.inf)
