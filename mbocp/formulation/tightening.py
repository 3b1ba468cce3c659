r"""Bounds that leave room for how far motions stray: numbers for each node, and nothing else of a programme.

A row :math:`\underline h \le h(x) \le \overline h` becomes, with the covariance P of the state there,

.. math:: \underline h + \beta \sqrt{h_x P h_x^T} \le h(x) \le \overline h - \beta \sqrt{h_x P h_x^T} ,

in which the root is a number, worked out along the motion before: the zero-order method of [Feng2020]_ and
[Zanelli2021]_.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.problem.uncertainty import Tube
from mbocp.programme import StagewiseProgramme

_LEAST_ROOM = 1e-6  # of a range, or of its unit: less is no room for an interior-point method


def margins_of(programme: StagewiseProgramme, tube: Tube) -> Array:
    """How far bounds of states, controls and path functions move, shape (N, nx + nu + nh).

    Zero where there are none, and where both sides are the same.
    """
    bounds, kind, N = programme.bounds, programme.kind, programme.num_steps
    after = tube.covariances[1:]
    of_states = np.sqrt(np.maximum(np.einsum("nii->ni", after), 0.0))
    if kind.nx != kind.ndx:  # then states have no limits
        of_states = np.zeros((N, kind.nx))
    of_path = np.zeros((N, bounds.nh))
    if bounds.nh:
        slopes = _path_slopes(programme, tube)
        of_path = np.sqrt(np.maximum(np.einsum("nhi,nij,nhj->nh", slopes, after, slopes), 0.0))
    spreads = np.hstack([of_states, tube.spreads, of_path])
    return np.where(bounds.has_limit & ~bounds.are_equations, tube.sigmas * spreads, 0.0)


def tighten(programme: StagewiseProgramme, tube: Tube) -> StagewiseProgramme:
    """The programme with bounds that leave room.

    Raises
    ------
    ProblemError
        If a range is narrower than the room on both its sides.
    """
    bounds, margins = programme.bounds, margins_of(programme, tube)
    lower, upper = bounds.lower + margins, bounds.upper - margins
    least = _LEAST_ROOM * np.fmax(1.0, np.where(np.isfinite(bounds.upper), np.abs(bounds.upper), 0.0))
    crossed = (margins > 0.0) & ~(lower + least < upper)
    if crossed.any():
        stage, entry = (int(i) for i in np.argwhere(crossed)[0])
        sides = f"[{bounds.lower[stage, entry]:.4g}, {bounds.upper[stage, entry]:.4g}]"
        raise ProblemError(
            f"robust: {words_of(programme, stage, entry)} has no room: {tube.sigmas:.3g} standard deviations "
            f"are {margins[stage, entry]:.4g} on each side of {sides}; widen the limit, or lower "
            "robust.sigmas or what is uncertain"
        )
    return replace(programme, bounds=bounds.with_sides(lower, upper))


def words_of(programme: StagewiseProgramme, stage: int, entry: int) -> str:
    """Words for a limit by its place in `StateBounds.has_limit`."""
    kind, limited = programme.kind, programme.bounds.has_limit
    rows = kind.ndx + kind.ny
    return programme.describe_row(stage, rows + int(np.count_nonzero(limited[stage, :entry])))


def _path_slopes(programme: StagewiseProgramme, tube: Tube) -> Array:
    """Derivatives of the path functions in the state, shape (N, nh, ndx)."""
    N, kind, nh = programme.num_steps, programme.kind, programme.bounds.nh
    function = programme.functions.function("path")
    given = [
        tube.xs[1:],
        np.zeros((N, nh)),
        tube.us,
        np.broadcast_to(programme.theta, (N, programme.theta.size)),
    ]
    values = programme.functions.stage_function("path").evaluate([np.ravel(v) for v in given], N, True)[1]
    rows, columns = function.sparsity_out(1).get_triplet()
    slopes = np.zeros((N, nh, kind.ndx))
    slopes[:, rows, columns] = np.reshape(values, (N, -1))
    return slopes
