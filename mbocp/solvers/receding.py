"""The start of a receding horizon: the kernel's loop at a solution of a programme.

The loop itself is the kernel's (`receding.hpp`): it shifts, takes exact Newton steps by the rules of all
solves, and allocates nothing.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import dataclass
from mbocp.exceptions import SolverError
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.programme.native_modules import kernel
from mbocp.solvers.newton_method.held_limits import GAIN_WEIGHT
from mbocp.solvers.newton_method.limit_multipliers import warm_barrier

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelHorizon, KernelProgramme

_MIN_BARRIER, _MAX_BARRIER = 1e-9, 1.0
_STEPS = 60  # to the optimum with the loop's barrier: the solution has another one


@dataclass(frozen=True)
class RecedingSettings:
    """What a receding horizon goes by.

    Attributes
    ----------
    barrier : float
        Part of the cost that the barriers of all limits may take together.
    tolerance : float
        Of the increment in all unknowns, below which a step has converged.
    """

    barrier: float
    tolerance: float


def make_receding_horizon(
    programme: StagewiseProgramme, iterate: Iterate, settings: RecedingSettings
) -> tuple[KernelHorizon, KernelProgramme]:
    """The kernel's loop at a solution, and the programme that it steps.

    Parameters
    ----------
    programme : StagewiseProgramme
        With stages of one kind.
    iterate : Iterate
        Its solution, or near one, with multipliers.
    settings : RecedingSettings

    Raises
    ------
    ProblemError
        If there are limits that the barrier cannot keep.
    SolverError
        If no Newton step can be taken there.
    """
    native = warm_barrier(programme, iterate, lambda cost, limits: _barrier(settings.barrier, cost, limits))
    horizon = loop_of(programme, native, settings)
    status = horizon.step(np.array(programme.x_start), 0.0, _STEPS, math.inf)
    if status.iterations == 0:
        raise SolverError(
            f"receding horizon: no Newton step can be taken from the solution ({status.outcome.name})"
        )
    return horizon, native


def loop_of(
    programme: StagewiseProgramme, native: KernelProgramme, settings: RecedingSettings
) -> KernelHorizon:
    """The kernel's loop over a programme, with the barrier that this has."""
    return kernel().RecedingHorizon(
        native,
        tolerance=settings.tolerance,
        barrier=settings.barrier,
        shift_unit=programme.control_weight,
        augmentation=GAIN_WEIGHT * programme.control_weight / programme.dt if programme.ng else 0.0,
    )


def _barrier(share: float, cost: float, num_limits: int) -> float:
    if not num_limits:
        return 0.0
    return min(max(share * abs(cost) / num_limits, _MIN_BARRIER), _MAX_BARRIER)
