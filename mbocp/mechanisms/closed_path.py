"""Paths of a mechanism from start to goal on which its loops stay closed: initial guesses use them."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp._linear import null_space
from mbocp._tolerances import ARRIVAL_TOLERANCE, RANK_TOLERANCE
from mbocp.mechanics import JointMechanics
from mbocp.robot import Robot
from mbocp.robot.loops.projection import follow, violations

__all__ = ["MAX_PATH_LENGTH", "closed_path", "constraint_jacobians", "driving_joints", "path_towards"]

MAX_PATH_LENGTH = 300.0  # [rad, m] 48 turns, which take a second or two

_MAX_LEAP = 0.3  # [rad, m] to the next configuration; a longer step is divided
_CLOSURE_TOLERANCE = 1e-12  # [m, rad, m^2]
_MAX_NEWTON_STEPS = 12  # quadratic: three are typical
_MIN_INDEPENDENCE = 0.05  # part of each motion along the constraints that a driving joint makes


def closed_path(robot: Robot, q_start: Array, q_goal: Array, shares: Array) -> Array | None:
    """Configurations from start to goal, the loops closed at each.

    The joints that drive the mechanism, those with motors first, move on a straight line; the others follow.

    Parameters
    ----------
    q_start, q_goal : ndarray, shape (nq,)
        Configurations that close the loops.
    shares : ndarray, shape (n,)
        Part of the line at each configuration; the last is 1.

    Returns
    -------
    qs : ndarray, shape (n, nq), or None
        None if the path gets stuck, ends elsewhere or is too long.
    """
    if np.abs(robot.difference(q_start, q_goal)).max(initial=0.0) > MAX_PATH_LENGTH:
        return None
    driving = driving_joints(robot, q_start)
    qs = path_towards(robot, q_start, q_goal, driving, shares)
    has_arrived = qs is not None and np.abs(robot.difference(qs[-1], q_goal)).max() <= ARRIVAL_TOLERANCE
    return qs if has_arrived else None


def path_towards(
    robot: Robot, q_start: Array, target: Array, wanted: BoolArray, shares: Array
) -> Array | None:
    """Configurations with the wanted components on the straight line to a target, the loops closed at each.

    Parameters
    ----------
    q_start, target : ndarray, shape (nq,)
        Configurations; the first closes the loops.
    wanted : ndarray of bool, shape (nv,)
        Velocity components of whole joints that move on the line.
    shares : ndarray, shape (n,)
        Part of the line at each configuration.

    Returns
    -------
    qs : ndarray, shape (n, nq), or None
        None if the path gets stuck.
    """
    whole = np.where(wanted, robot.difference(q_start, target), 0.0)
    q, qs, last = q_start, [], np.zeros(robot.nv)
    for share in shares:
        there = robot.integrate(q_start, share * whole)
        ahead = np.where(wanted, robot.difference(q, there), last)  # the others keep their rate
        near = _closed_by_newton(robot, q, ahead, ~wanted)
        found = follow(robot, q, there, wanted) if near is None else near
        if np.abs(robot.difference(found, there)[wanted]).max(initial=0.0) > ARRIVAL_TOLERANCE:
            return None
        last = np.zeros(robot.nv) if near is None else robot.difference(q, found)
        q = found
        qs.append(q)
    is_closed = not qs or not violations(robot, q)
    return np.array(qs) if is_closed else None


def constraint_jacobians(robot: Robot, qs: Array) -> Array:
    """Derivatives of the constraints at many configurations (k, nq), shape (k, nc, nv)."""
    if not robot.nc:
        return np.zeros((len(qs), 0, robot.nv))
    _, columns = _closure(robot).map(len(qs))(qs.T)
    found: Array = columns.full().reshape(robot.nc, len(qs), robot.nv).transpose(1, 0, 2)
    return found


def driving_joints(robot: Robot, q: Array) -> BoolArray:
    """Velocity components of joints that determine the motion of the mechanism, those with a motor first."""
    basis = null_space(robot.constraint_jacobian(q), RANK_TOLERANCE)
    chosen = np.zeros(robot.nv, dtype=np.bool_)
    has_motor = np.abs(robot.actuation.selection).sum(axis=1) > 0.0
    slices = [robot.velocity_indices(name) for name in robot.joint_names]
    for where in sorted(slices, key=lambda s: not has_motor[s].any()):
        if basis.shape[1] == 0 or where.stop == where.start:
            continue
        rows = basis[where]
        if np.linalg.svd(rows, compute_uv=False)[: rows.shape[0]].min() < _MIN_INDEPENDENCE:
            continue
        chosen[where] = True
        basis = basis @ null_space(rows, RANK_TOLERANCE)
    return chosen


def _closed_by_newton(robot: Robot, q: Array, ahead: Array, free: BoolArray) -> Array | None:
    """Configuration moved by `ahead`, its loops closed by the free joints with Newton's method.

    None if the method does not converge or a joint would leap.
    """
    closure, found = _closure(robot), robot.integrate(q, ahead)
    for _ in range(_MAX_NEWTON_STEPS):
        phi, dPhi_dq = (value.full() for value in closure(found))
        if np.abs(phi).max() < _CLOSURE_TOLERANCE:
            is_near = np.abs(robot.difference(q, found)).max() < _MAX_LEAP
            return found if is_near else None
        step = np.zeros(robot.nv)
        step[free] = -np.linalg.lstsq(dPhi_dq[:, free], phi.ravel(), rcond=None)[0]
        if np.abs(step).max() > _MAX_LEAP:
            return None
        found = robot.integrate(found, step)
    return None


def _closure(robot: Robot) -> ca.Function:
    """(q) -> (Phi, dPhi_dq) in one call, built once for a robot; by Pinocchio it takes many calls."""
    if robot not in _closures:
        mechanics, q = JointMechanics(robot), ca.SX.sym("q", robot.nq)
        rows = [mechanics.constraints(q), mechanics.constraint_jacobian(q)]
        _closures[robot] = ca.Function("closure", [q], [ca.densify(value) for value in rows])
    return _closures[robot]


_closures: WeakKeyDictionary[Robot, ca.Function] = WeakKeyDictionary()
