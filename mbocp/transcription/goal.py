"""Exact end conditions: which rows, and projected onto what the constraints leave free."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.problem import Goal
from mbocp.problem.consistency import tangent_space
from mbocp.robot import Robot

__all__ = ["end_condition_rows"]

_RANK_TOLERANCE = (
    1e-9  # relative to the largest singular value: far above round-off, far below any real direction
)


def end_condition_rows(robot: Robot, goal: Goal) -> tuple[Array, Array]:
    r"""Projections D_q, D_rate of the exact end condition, eq. (14).

    Eq. (14) as printed asks for all of p = p_d and is rank-deficient on a constrained system: the discrete
    steps already tie the last momentum to the constraint surface. Both parts are therefore projected onto
    the tangent space, by SVD for any constraint and any subset of conditions.

    Parameters
    ----------
    robot : Robot
        Gives the constraint Jacobian and the mass matrix at the goal.
    goal : Goal
        Which components are enforced.

    Returns
    -------
    D_q : ndarray, shape (ng_q, nv)
        Acts on the tangent-space difference of q and q_d.
    D_rate : ndarray, shape (ng_rate, nv)
        Acts on p - p_d or v - v_d.
    """
    if goal.enforce not in ("exact", "both"):
        return np.zeros((0, robot.nv)), np.zeros((0, robot.nv))
    basis = tangent_space(robot, goal.q)
    moment_basis = robot.mass_matrix(goal.q) @ basis if goal.rate == "p" else basis
    return _project(goal.q_active, basis, basis), _project(goal.rate_active, moment_basis, basis)


def _project(active: BoolArray, reachable: Array, basis: Array) -> Array:
    """Independent rows among the `active` ones, given the `reachable` directions."""
    if not active.any():
        return np.zeros((0, active.size))
    if active.all():  # the tangential projection of the paper, P' (y - y_d)
        return np.ascontiguousarray(basis.T)
    selection = np.eye(active.size)[active]
    left, values, _ = np.linalg.svd(selection @ reachable, full_matrices=False)
    rank = int(np.sum(values > _RANK_TOLERANCE * max(values[0], 1e-300)))
    if rank == selection.shape[0]:
        return selection
    return np.ascontiguousarray(left[:, :rank].T @ selection)
