r"""A configuration within bounds that reaches poses, from a start near or far: damped Gauss-Newton steps.

.. math:: \left(J^T J + \mu I\right) \delta = -J^T e, \qquad q \leftarrow q \circ \exp(\delta)

The damping is a multiple of the cost [Sugihara2011]_, so that convergence is quadratic at a pose within
reach, also at singular configurations. Joints that a step would take beyond their bounds stop there, and
those at a bound that the gradient pushes outwards take no part in the step (a projected Newton's method).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray
from mbocp.robot.poses.bounds import JointBounds

_MAX_ITERATIONS = 80  # six to fifteen are typical
_MAX_STEP = 1.0  # [rad, m] of one joint
_MIN_DAMPING = 1e-14  # of the largest diagonal entry: above round-off
_MIN_FACTOR, _MAX_FACTOR = 1e-3, 1e8  # damping by cost
_MAX_STALLED, _STALL_RATIO = 6, 0.98  # iterations in a row that leave more than this part of the cost
_MIN_GRADIENT = 1e-9  # [m, rad] by [rad, m]: at a local minimum, relative to the residual


class ReachRows(Protocol):
    """What is to vanish, see `mbocp.robot.poses.rows.PoseRows`."""

    @property
    def model(self) -> pin.Model:
        """Tree of joints."""

    def residual(self, q: Array) -> Array:
        """All rows at a configuration."""

    def jacobian(self, q: Array) -> Array:
        """Their derivative in tangent coordinates; `residual` has been called at the same q."""


def reach(
    rows: ReachRows, q: Array, bounds: JointBounds, held: BoolArray, tolerance: float
) -> tuple[Array, bool]:
    """Return the configuration that the steps from `q` lead to, and whether all rows vanish there.

    Parameters
    ----------
    rows : ReachRows
    q : ndarray, shape (nq,)
        Within the bounds.
    bounds : JointBounds
    held : ndarray of bool, shape (nv,)
        Velocity components of joints that stay where they are.
    tolerance : float
        Of each row [m, rad].
    """
    factor, stalled = 1.0, 0
    e = rows.residual(q)
    cost = float(e @ e)
    for _ in range(_MAX_ITERATIONS):
        has_arrived = np.abs(e).max() <= tolerance
        J = rows.jacobian(q)
        gradient = J.T @ e
        free = ~(bounds.blocks(q, gradient) | held)
        if not free.any() or np.abs(gradient[free]).max() <= _MIN_GRADIENT * np.sqrt(cost):
            return q, bool(has_arrived)
        found = _step(rows, q, J, gradient, free, factor * cost, bounds)
        e_found = rows.residual(found)
        cost_found = float(e_found @ e_found)
        if cost_found < cost:
            stalled = stalled + 1 if cost_found > _STALL_RATIO * cost else 0
            q, e, cost = found, e_found, cost_found
            factor = max(0.2 * factor, _MIN_FACTOR)
        else:
            factor, stalled = 8.0 * factor, stalled + 1
        if has_arrived or stalled > _MAX_STALLED or factor > _MAX_FACTOR:
            break
    return q, bool(np.abs(e).max() <= tolerance)


def _step(
    rows: ReachRows, q: Array, J: Array, gradient: Array, free: BoolArray, mu: float, bounds: JointBounds
) -> Array:
    step = np.zeros(gradient.size)
    columns = J if free.all() else J[:, free]
    normal = columns.T @ columns
    diagonal = normal.flat[:: len(normal) + 1]
    normal.flat[:: len(normal) + 1] = diagonal + mu + _MIN_DAMPING * diagonal.max()
    step[free] = -np.linalg.solve(normal, gradient[free])
    longest = np.abs(step).max()
    if longest > _MAX_STEP:
        step *= _MAX_STEP / longest
    moved: Array = pin.integrate(rows.model, q, step)
    return bounds.clip(moved)
