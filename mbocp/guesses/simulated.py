"""A guess by forward simulation: it always satisfies the dynamics."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.formulation import Formulation
from mbocp.formulation.features.step_lengths import length_controls
from mbocp.programme import Iterate
from mbocp.programme.kernel import kernel_programme

_SWEEP_TOLERANCE = 1e-12  # of a step's residual; a Newton step below that is round-off
_SWEEP_ITERATIONS = 50


def guess_by_simulation(
    formulation: Formulation, u: Array, *, tolerance: float = _SWEEP_TOLERANCE, **how: bool
) -> Iterate:
    """Constant control and forward simulation, the paper's guess (section 6).

    Parameters
    ----------
    formulation : Formulation
    u : ndarray, shape (nu,)
        Control of all steps.
    tolerance : float
        Of the residual of each step, in its unit of force.
    **how : bool
        What the kernel's `simulate` takes. With ``compensated = True`` the rows of a step take what rounding
        the states left of those before (section VIII.5 of [Hairer2006]_): the round-off of many steps does
        not add up then.
    """
    problem, programme = formulation.problem, formulation.programme
    native = kernel_programme(programme, sweeps=True)
    at = formulation.layout
    values = formulation.pieces.signature.control_values
    us = np.zeros((problem.num_steps, at.num_controls))
    us[:, : at.num_own] = values.constant(np.tile(u, (problem.num_steps, 1)))
    if "lengths" in at.controls:
        us[:, at.controls["lengths"]] = length_controls(problem, problem.timeline.lengths())
    native.u = us.ravel()
    xs = np.zeros((problem.num_steps + 1, programme.x_start.size))
    xs[0] = programme.x_start
    native.x = xs.ravel()
    sweep = native.simulate(tolerance, _SWEEP_ITERATIONS, **how)
    if not sweep.ok:
        raise ProblemError(
            f"guess: the forward simulation with constant control fails "
            f"{programme.describe_step(sweep.failed_stage)} "
            f"(residual {sweep.residual:.1e}); take more steps, another guess.u, or another guess.kind"
        )
    return Iterate.read_from(native, programme)
