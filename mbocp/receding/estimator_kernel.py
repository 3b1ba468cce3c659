"""The kernel's loop of an estimator."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbocp.programme.compilation import CompiledFunctions
from mbocp.programme.native_modules import kernel
from mbocp.receding.estimator_functions import EstimatorLayout

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelHorizon, KernelProgramme

_TOLERANCE = 1e-9  # of a Gauss-Newton step, in the units of states and noise


def estimator_kernel(
    functions: CompiledFunctions, at: EstimatorLayout, num_stages: int
) -> tuple[KernelProgramme, KernelHorizon]:
    """Programme of so many stages, and the loop that moves it on; both are all zeros."""
    native, of = kernel(), functions.stage_function
    kind = native.Kind(
        nx=at.nx,
        ndx=at.ndx,
        ny=0,
        nu=at.nw,
        nr=at.num_rho,
        values=of("values"),
        jacobian=of("jacobian"),
        complete=of("complete"),
        scale_c=np.ones(at.ndx),
        scale_y=np.zeros(0),
        scale_m=np.ones(at.ndx),
        scale_ru=np.ones(at.nw),
    )
    end = native.Terminal(ng=0, values=of("terminal_values"), complete=of("terminal_complete"))
    programme = native.Programme(num_stages, kind, end, of("retract"), of("difference"))
    horizon = native.RecedingHorizon(
        programme, tolerance=_TOLERANCE, barrier=0.0, shift_unit=1.0, augmentation=0.0
    )
    return programme, horizon
