"""Rows of a residual made small at many configurations at once, by steps of Gauss and Newton.

Each step is the shortest in the norm of the mass matrix: light links follow heavy ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.robot import kinematics
from mbocp.robot.mechanism import Mechanism

_OfMany: TypeAlias = Callable[[Array], Array]

CLOSURE_TOLERANCE = 1e-10  # [m, rad, m^2] of the rows that are kept; 1e-15 is usual

_ROUND_OFF = 1e-15
_MAX_ITERATIONS = 60  # quadratic at the end: six to ten are typical
# At a local minimum: iterations in a row that leave more than this part of the residual.
_MAX_STALLED, _STALL_RATIO = 4, 0.995
_MAX_STEP = 0.4  # [rad, m] of one joint within an iteration
_MIN_DAMPING, _FIRST_DAMPING, _MAX_DAMPING = 1e-8, 1e-4, 1e3
_REGULARISATION = 1e-6  # of the largest inertia: added to the diagonal of a singular mass matrix
_MIN_SINGULAR_VALUE = 1e-100  # below, the square of a singular value underflows


def reduce_rows(
    robot: Mechanism,
    qs: Array,
    free: BoolArray,
    residuals: _OfMany,
    jacobians: _OfMany,
    enough: float = _ROUND_OFF,
) -> Array:
    """Reduce a residual as far as possible, at each of n configurations by itself.

    Parameters
    ----------
    qs : ndarray, shape (n, nq)
    free : ndarray of bool, shape (nv,)
        Velocity components that may move.
    residuals, jacobians : callable
        From m of the configurations to the rows, shape (m, rows), and to their derivatives, shape
        (m, rows, nv), with columns in tangent coordinates.
    enough : float
        Residual below which it ends [m, rad].

    Returns
    -------
    qs : ndarray, shape (n, nq)
        Moved by steps that are the shortest in the norm of the mass matrix.
    """
    qs, rests, is_open = np.array(qs), np.array(residuals(qs)), np.ones(len(qs), dtype=np.bool_)
    damping, stalled = np.zeros(len(qs)), np.zeros(len(qs), dtype=np.intp)
    for _ in range(_MAX_ITERATIONS):
        is_open &= ~((_largest(rests) < enough) | (stalled == _MAX_STALLED))
        at = np.flatnonzero(is_open)
        if not at.size:
            break
        tried = _take_step(robot, qs[at], free, jacobians(qs[at]), -rests[at], damping[at])
        after = residuals(tried)
        with np.errstate(over="ignore", invalid="ignore"):  # squares of lengths beyond 1e154 m: no progress
            shares = np.linalg.norm(after, axis=1) / np.linalg.norm(rests[at], axis=1)
        is_better = shares < 1.0
        good, bad = at[is_better], at[~is_better]
        is_open[bad[(_largest(rests[bad]) < CLOSURE_TOLERANCE) | (damping[bad] > _MAX_DAMPING)]] = False
        damping[bad] = np.maximum(10.0 * damping[bad], _FIRST_DAMPING)
        damping[good] = np.where(damping[good] > _MIN_DAMPING, damping[good] / 10.0, 0.0)
        stalled[good] = np.where(shares[is_better] > _STALL_RATIO, stalled[good] + 1, 0)
        qs[good], rests[good] = tried[is_better], after[is_better]
    return qs


def _take_step(
    robot: Mechanism, qs: Array, free: BoolArray, jacobians: Array, wanted: Array, damping: Array
) -> Array:
    """Configurations after a step each, none of whose joints moves far."""
    steps = np.zeros((len(qs), robot.nv))
    metrics = metrics_of(robot, qs)[:, free][:, :, free]
    steps[:, free] = shortest_steps(metrics, jacobians[:, :, free], wanted, damping)
    steps *= np.minimum(1.0, _MAX_STEP / np.maximum(_largest(steps), _MAX_STEP))[:, None]
    return np.array([pin.integrate(robot.model, *pair) for pair in zip(qs, steps, strict=True)])


def metrics_of(robot: Mechanism, qs: Array) -> Array:
    """Mass matrices, shape (n, nv, nv); where one is singular, with a little inertia for all."""
    masses = kinematics.mass_matrices(robot.model, qs)
    if not kinematics.any_singular(masses):
        return masses
    for mass in masses:
        if kinematics.is_singular(mass):
            least = _REGULARISATION * float(np.diag(mass).max(initial=0.0)) or 1.0
            mass += least * np.eye(robot.nv)
    return masses


def shortest_steps(metrics: Array, jacobians: Array, wanted: Array, damping: Array) -> Array:
    """Steps with J step = wanted that are the shortest in a metric; with damping, shorter.

    Parameters
    ----------
    metrics : ndarray, shape (n, k, k)
    jacobians : ndarray, shape (n, rows, k)
    wanted : ndarray, shape (n, rows)
    damping : ndarray, shape (n,)
        Of squares of singular values, by that of the largest.

    Returns
    -------
    steps : ndarray, shape (n, k)
    """
    if not metrics.size:
        return np.zeros(metrics.shape[:2])
    roots = np.linalg.cholesky(metrics)
    scaled = np.linalg.solve(roots, jacobians.transpose(0, 2, 1)).transpose(0, 2, 1)  # J L^-T
    u, singular, vt = np.linalg.svd(scaled, full_matrices=False)
    largest = singular.max(axis=1, initial=0.0)
    used = singular > np.maximum(RANK_TOLERANCE * largest, _MIN_SINGULAR_VALUE)[:, None]
    inverse = np.zeros_like(singular)
    np.divide(singular, singular**2 + (damping * largest**2)[:, None], out=inverse, where=used)
    parts = inverse[:, :, None] * (u.transpose(0, 2, 1) @ wanted[:, :, None])
    steps: Array = np.linalg.solve(roots.transpose(0, 2, 1), vt.transpose(0, 2, 1) @ parts)[:, :, 0]
    return steps


def _largest(rows: Array) -> Array:
    return np.abs(rows).max(axis=1, initial=0.0)
