r"""Values of the controls within a step: the first controls of the programme.

Which there are is for `mbocp.integrators.controls` to say. A step has k values of each control, one block
after the other. Values at the stages of the method belong to their step alone. Continuous controls begin a
step with the value that the state remembers of the step before, so that only the first step has a first
block of its own:

.. math:: u_0 = e\, w_0 + (1 - e)\, r, \qquad u_1 = w_1, \qquad r^+ = u_1,

with e = 1 in the first step and 0 in all others. Where e is 0 nothing depends on the first block, and half
its square is added to the cost, which is zero at the optimum.
"""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.layout import StateLayout
from mbocp.integrators import control_basis, control_means

__all__ = [
    "constant_values",
    "ends_of",
    "filled_values",
    "means_of",
    "slopes_of",
    "spread_limits",
    "values_of",
    "with_values",
]


def values_of(at: StateLayout, us: Array) -> Array:
    """Values among the controls (N, any) of a programme, shape (N, k, nu); shape (0, 0, 0) if constant."""
    if not at.shares:
        return np.zeros((0, 0, 0))
    values = np.array(us[:, : at.num_own].reshape(len(us), at.num_values, at.nu))
    if at.is_continuous:
        values[1:, 0] = values[:-1, -1]
    return values


def means_of(at: StateLayout, us: Array) -> Array:
    """Means over the steps of the controls (N, any) of a programme, shape (N, nu)."""
    if not at.shares:
        return us[:, : us.shape[1] - at.num_more_controls]
    means: Array = np.einsum("k,nku->nu", control_means(at.shares), values_of(at, us))
    return means


def ends_of(at: StateLayout, us: Array) -> Array:
    """Controls at the ends of the steps from those (N, any) of a programme, shape (N, nu)."""
    if not at.shares:
        return us[:, : at.nu]
    ends: Array = np.einsum("k,nku->nu", control_basis(at.shares, [1.0])[0], values_of(at, us))
    return ends


def slopes_of(at: StateLayout, us: Array, dts: Array) -> Array | None:
    """Rates of linear controls in the steps [1/s], shape (N, nu); None where controls leap between steps."""
    if not at.is_continuous:
        return None
    values = values_of(at, us)
    slopes: Array = (values[:, 1] - values[:, 0]) / dts[:, None]
    return slopes


def constant_values(at: StateLayout, us: Array) -> Array:
    """Controls of the programme with which all values in a step are those of `us`, shape (N, k nu)."""
    values = np.repeat(us[:, None], at.num_values, axis=1)
    return with_values(at, us, values, np.ones(len(us)))


def filled_values(at: StateLayout, means: Array, dts: Array) -> Array:
    """Values (N, k, nu) of a guess: its means (N, nu), interpolated between the middles of the steps."""
    ends = np.cumsum(dts)
    middles = ends - dts / 2.0
    times = (ends - dts)[:, None] + np.outer(dts, at.shares)
    columns = [np.interp(times.ravel(), middles, mean) for mean in means.T]
    return np.reshape(np.column_stack(columns), (len(dts), at.num_values, at.nu))


def with_values(at: StateLayout, us: Array, values: Array, dts: Array) -> Array:
    """Controls of the programme that controls (N, nu) with values within the steps stand for, shape (N, any).

    `values`, shape (N, k, nu), are filled in where there are none of this layout.
    """
    if not at.shares:
        return us
    found = np.array(values if values.shape[1] == at.num_values else filled_values(at, us, dts))
    if at.is_continuous:
        found[1:, 0] = 0.0
    return found.reshape(len(us), at.num_own)


def spread_limits(at: StateLayout, lower: Array, upper: Array, num_steps: int) -> tuple[Array, Array]:
    """Bounds of all values, shapes (N, k nu), from those of the controls, shapes (N, nu) or (1, nu).

    The end of a step is the begin of the next one where controls are continuous: both their limits hold.
    """
    if not at.shares:
        return lower, upper
    sides = []
    for bounds, free, narrower in ((lower, -np.inf, np.maximum), (upper, np.inf, np.minimum)):
        rows = np.array(np.broadcast_to(bounds, (num_steps, at.nu)))
        blocks = [rows] * at.num_values
        if at.is_continuous:
            ends, begins = rows.copy(), np.full_like(rows, free)
            ends[:-1] = narrower(rows[:-1], rows[1:])
            begins[0] = rows[0]
            blocks = [begins, ends]
        sides.append(np.hstack(blocks))
    return sides[0], sides[1]
