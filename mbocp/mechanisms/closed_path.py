"""Paths of a mechanism from start to goal on which its loops stay closed: initial guesses use them."""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, null_space
from mbocp._tolerances import ARRIVAL_TOLERANCE, RANK_TOLERANCE
from mbocp.mechanics import JointMechanics
from mbocp.robot import Robot
from mbocp.robot.kinematics import difference
from mbocp.robot.loops.projection import follow, violations

MAX_PATH_LENGTH = 300.0  # [rad, m] 48 turns, which take a second or two

_MAX_LEAP = 0.3  # [rad, m] to the next configuration; a longer step is divided
_CLOSURE_TOLERANCE = 1e-12  # [m, rad, m^2]
_MIN_STEP = 1.0 / 64.0  # of the way from one configuration to the next
_MAX_NEWTON_STEPS = 12  # quadratic: three are typical
_MIN_INDEPENDENCE = 0.05  # part of each motion along the constraints that a driving joint makes


def find_closed_path(robot: Robot, q_start: Array, q_goal: Array, shares: Array) -> Array | None:
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
    driving = find_driving_joints(robot, q_start)
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
    q, qs, last, loops = q_start, [], np.zeros(robot.nv), _Loops(robot, wanted)
    for share in shares:
        there = pin.integrate(robot.model, q_start, share * whole)
        near = loops.lead_to(q, there, last)
        found = follow(robot, q, there, wanted) if near is None else near
        if np.abs(difference(robot.model, found, there)[wanted]).max(initial=0.0) > ARRIVAL_TOLERANCE:
            return None
        last = np.zeros(robot.nv) if near is None else difference(robot.model, q, found)
        q = found
        qs.append(q)
    is_closed = not qs or not violations(robot, q)
    return np.array(qs) if is_closed else None


def constraint_jacobians(robot: Robot, qs: Array) -> Array:
    """Derivatives of the constraints at many configurations (k, nq), shape (k, nc, nv)."""
    if not robot.nc:
        return np.zeros((len(qs), 0, robot.nv))
    _, columns = _closure(robot).map(len(qs))(qs.T)
    return columns.full().reshape(robot.nc, len(qs), robot.nv).transpose(1, 0, 2)


def find_driving_joints(robot: Robot, q: Array) -> BoolArray:
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


class _Loops:
    """Loops of a mechanism that some joints close while the others are led.

    Parameters
    ----------
    robot : Robot
    led : ndarray of bool, shape (nv,)
    """

    def __init__(self, robot: Robot, led: BoolArray) -> None:
        self._model, self._led, self._free = robot.model, led, np.flatnonzero(~led)
        self._q = np.zeros(robot.nq)
        columns = np.zeros((robot.nv, robot.nc))
        self._phi, self._dPhi_dq = np.zeros(robot.nc), columns.T
        buffer: Any
        buffer, self._evaluate = _closure(robot).buffer()  # reads and writes these arrays
        buffer.set_arg(0, self._q.data)
        buffer.set_res(0, self._phi.data)
        buffer.set_res(1, columns.data)
        self._buffer = buffer  # as long as it is called

    def lead_to(self, q: Array, there: Array, last: Array) -> Array | None:
        """Configuration with the led components of another, its loops closed step by step on the line to it.

        Steps are as long as Newton's method takes them without a leap: the mechanism stays in its assembly
        mode. None if that takes many.

        Parameters
        ----------
        q, there : ndarray, shape (nq,)
        last : ndarray, shape (nv,)
            By how much components moved on a way of this length before: the others begin at that rate.
        """
        gone, step, rate = 0.0, 1.0, last
        while gone < 1.0:
            left = difference(self._model, q, there)
            ahead = np.where(self._led, left * (step / (1.0 - gone)), step * rate)
            leaps = np.abs(ahead[self._led]).max(initial=0.0) >= _MAX_LEAP  # wherever the others end
            found = None if leaps else self._close(q, ahead)
            if found is not None:
                rate = difference(self._model, q, found) / step
                q, gone, step = found, gone + step, min(2.0 * step, 1.0 - gone - step)
            elif step > _MIN_STEP:
                step /= 2.0
            else:
                return None
        return q

    def _close(self, q: Array, ahead: Array) -> Array | None:
        """Configuration moved by `ahead`, its loops closed by the other joints with Newton's method.

        None if the method does not converge or a joint would leap.
        """
        found: Array = pin.integrate(self._model, q, ahead)
        step = np.zeros(self._model.nv)
        for _ in range(_MAX_NEWTON_STEPS):
            self._q[:] = found
            self._evaluate()
            if np.abs(self._phi).max() < _CLOSURE_TOLERANCE:
                is_near = np.abs(difference(self._model, q, found)).max() < _MAX_LEAP
                return found if is_near else None
            step[self._free] = -_least_squares(self._dPhi_dq[:, self._free], self._phi)
            if not np.abs(step).max() <= _MAX_LEAP:
                return None
            found = pin.integrate(self._model, found, step)
        return None


def _least_squares(matrix: Array, values: Array) -> Array:
    """Shortest of the nearest solutions of a linear system."""
    if matrix.shape[0] == matrix.shape[1]:
        try:
            found = np.linalg.solve(matrix, values)  # a third of the time
        except np.linalg.LinAlgError:
            pass  # singular
        else:
            return np.asarray(found, dtype=np.float64)
    return np.asarray(np.linalg.lstsq(matrix, values, rcond=None)[0], dtype=np.float64)


def _closure(robot: Robot) -> ca.Function:
    """(q) -> (Phi, dPhi_dq) in one call, built once for a robot; by Pinocchio it takes many calls."""
    if robot not in _closures:
        mechanics, q = JointMechanics(robot), ca.SX.sym("q", robot.nq)
        rows = [mechanics.constraints(q), mechanics.constraint_jacobian(q)]
        _closures[robot] = ca.Function("closure", [q], [ca.densify(value) for value in rows])
    return _closures[robot]


_closures: WeakKeyDictionary[Robot, ca.Function] = WeakKeyDictionary()
