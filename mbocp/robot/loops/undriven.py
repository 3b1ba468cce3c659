r"""Motions of closed loops that no motor drives: a rod between two ball joints turns about itself.

The columns of W(q) span the motions along the constraints on which no motor and no drive does work,

.. math:: G W = 0, \qquad B^T W = 0.

Where nothing else acts along them either, and masses are spread evenly about the axis, their momentum stays
zero from rest on, :math:`W^T M v = 0`. Nothing steers them, and light rods hardly matter to the
rest; but they scale the equations badly, and an end at rest asks for what no control can give.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._linear import null_space, spanning_rows
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.robot.kinematics import is_singular
from mbocp.robot.large import working_data
from mbocp.robot.loops.projection import gauss_newton, violations
from mbocp.robot.robot import Robot

_NUM_POSES = 3  # at which momenta are looked at
_SPREAD = 0.1  # [rad, m] between them
_TIME = 1e-5  # [s] over which a momentum may change
_KEPT = 1e-2  # [1/s] relative change of a momentum: light rods have 1e-3 of round-off, uneven ones 0.3
_MIN_MOMENTUM = 1e-300
_MOST = 0.1  # change of the inertia that motors feel by what is held


def undriven_motions(robot: Robot, q: Array) -> Array:
    """Orthonormal basis W(q) of the motions that no motor drives, shape (nv, any)."""
    along = _tangent(robot, q)
    rows = np.vstack([robot.actuation_matrix(q).T, np.eye(robot.nv)[list(robot.driven)]])
    return along @ null_space(rows @ along, RANK_TOLERANCE)


class Held(NamedTuple):
    """Joints that, held, end the motions which no motor drives.

    Attributes
    ----------
    joints : tuple of str
    change : float
        By which part the inertia that motors feel grows at most, at the initial pose.
    """

    joints: tuple[str, ...] = ()
    change: float = 0.0


def joints_to_hold(robot: Robot) -> Held:
    """Find the joints to hold; none where what no motor drives swings, is heavy, or is part of a joint."""
    if not robot.nc:
        return Held()
    motions, along = undriven_motions(robot, robot.q0), _tangent(robot, robot.q0)
    if not motions.size or is_singular(along.T @ robot.mass_matrix(robot.q0) @ along):  # refused later
        return Held()
    places = [(robot.velocity_indices(name), name) for name in robot.joint_names]
    single = {place.start: name for place, name in places if place.stop - place.start == 1}
    at = sorted(single)
    rows = spanning_rows(motions[at], RANK_TOLERANCE)
    if len(rows) < motions.shape[1] or not _keep_momentum(robot):
        return Held()
    chosen = [at[row] for row in rows]
    change = _change_of_inertia(robot, motions, chosen)
    return Held(tuple(single[i] for i in chosen), change) if change < _MOST else Held()


def _change_of_inertia(robot: Robot, motions: Array, held: Sequence[int]) -> float:
    """By which part the inertia of driven motions grows at most, where components are held."""
    along, mass = _tangent(robot, robot.q0), robot.mass_matrix(robot.q0)
    fixed = along @ null_space(along[list(held)], RANK_TOLERANCE)
    pull = motions.T @ mass
    # What is not held moves as it will.
    free = fixed - motions @ np.linalg.solve(pull @ motions, pull @ fixed)
    root = np.linalg.cholesky(free.T @ mass @ free)
    ratio = np.linalg.solve(root, np.linalg.solve(root, fixed.T @ mass @ fixed).T)
    return float(np.linalg.eigvalsh(ratio)[-1]) - 1.0


def _tangent(robot: Robot, q: Array) -> Array:
    return null_space(robot.constraint_jacobian(q), RANK_TOLERANCE)


def _keep_momentum(robot: Robot) -> bool:
    """Whether momenta of all motions that no motor drives stay zero, at the initial pose and near it."""
    rng, everything = np.random.default_rng(0), np.ones(robot.nv, dtype=np.bool_)
    along = _tangent(robot, robot.q0)
    for number in range(_NUM_POSES):
        away = along @ rng.normal(scale=number * _SPREAD, size=along.shape[1])
        q = gauss_newton(robot, robot.integrate(robot.q0, away), everything, robot.kept_rows)
        free = _without_momentum(robot, q)
        v = free @ rng.normal(size=free.shape[1])
        v /= max(float(np.abs(v).max(initial=0.0)), _MIN_MOMENTUM)  # at 1 rad/s: slower is lost in round-off
        if not violations(robot, q) and _change_of_momentum(robot, q, v) > _KEPT:
            return False
    return True


def _without_momentum(robot: Robot, q: Array) -> Array:
    """Orthonormal basis of the velocities without momentum along motions that no motor drives."""
    along = _tangent(robot, q)
    momenta = undriven_motions(robot, q).T @ robot.mass_matrix(q) @ along
    lengths = np.linalg.norm(momenta, axis=1, keepdims=True)
    return along @ null_space(momenta / np.where(lengths > 0.0, lengths, 1.0), RANK_TOLERANCE)


def _change_of_momentum(robot: Robot, q: Array, v: Array) -> float:
    """Of motions that no motor drives, from zero, relative to the largest part of it [1/s]."""
    mass, rows = robot.mass_matrix(q), robot.constraint_jacobian(q)
    bent = (robot.constraint_jacobian(robot.integrate(q, _TIME * v)) - rows) @ v / _TIME
    forces = pin.nonLinearEffects(robot.model, working_data(robot.model), q, v) - robot.force_elements(q, v)
    nothing = np.zeros((len(rows), len(rows)))
    found = np.linalg.lstsq(np.block([[mass, rows.T], [rows, nothing]]), -np.append(forces, bent), rcond=None)
    a = found[0][: robot.nv]
    after = robot.integrate(q, _TIME * v + 0.5 * _TIME**2 * a)
    motions, mass = undriven_motions(robot, after), robot.mass_matrix(after)
    largest = np.abs(motions).T @ np.abs(mass) @ np.abs(v)
    change = np.abs(motions.T @ mass @ (v + _TIME * a)) / _TIME
    return float((change / np.maximum(largest, _MIN_MOMENTUM)).max(initial=0.0))
