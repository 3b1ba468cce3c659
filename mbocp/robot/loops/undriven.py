r"""Motions of closed loops that no motor drives: a rod between two ball joints turns about itself.

The columns of W(q) span the motions along the constraints on which no motor and no drive does work, and in
which what floats is still, since feet or holds may carry it,

.. math:: G W = 0, \qquad B^T W = 0.

Where neither gravity nor springs act along them, nothing steers them, and light rods hardly matter to the
rest; but they scale the equations badly, and an end at rest asks for what no control can give.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, null_space, select_spanning_rows
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.robot import joints
from mbocp.robot.kinematics import is_singular
from mbocp.robot.large import make_working_data
from mbocp.robot.loops.projection import gauss_newton, violations
from mbocp.robot.robot import Robot

_NUM_POSES = 3  # at which forces are looked at
_SPREAD = 0.1  # [rad, m] between them
_PULLED = 1e-3  # [1/s] change of a momentum: rods of CAD files have 4e-7, those that swing 0.2 and more
_MIN_MOMENTUM = 1e-300
_MOST = 0.1  # change of the inertia that motors feel by what is held


def undriven_motions(robot: Robot, q: Array) -> Array:
    """Orthonormal basis W(q) of the motions that no motor drives, shape (nv, any)."""
    along, model = _tangent(robot, q), robot.model
    still = [
        dof
        for joint in range(1, model.njoints)
        if joints.joint_kind(model, joint).word == "floating"
        for dof in range(robot.nv)[joints.velocity_slice(model, joint)]
    ]
    rows = np.vstack([robot.actuation_matrix(q).T, np.eye(robot.nv)[[*robot.driven, *still]]])
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
    rows = select_spanning_rows(motions[at], RANK_TOLERANCE)
    if len(rows) < motions.shape[1] or _swing(robot):
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


def _swing(robot: Robot) -> bool:
    """Whether gravity or springs move what no motor drives, at the initial pose or near it."""
    rng, everything = np.random.default_rng(0), np.ones(robot.nv, dtype=np.bool_)
    along = _tangent(robot, robot.q0)
    for number in range(_NUM_POSES):
        away = along @ rng.normal(scale=number * _SPREAD, size=along.shape[1])
        q = gauss_newton(robot, robot.integrate(robot.q0, away), everything, robot.kept_rows)
        if not violations(robot, q) and _pull(robot, q) > _PULLED:
            return True
    return False


def _pull(robot: Robot, q: Array) -> float:
    """Change of momenta at rest, relative to the largest part they have at 1 rad/s of a joint [1/s]."""
    motions, still = undriven_motions(robot, q), np.zeros(robot.nv)
    forces = pin.nonLinearEffects(robot.model, make_working_data(robot.model), q, still)
    largest = np.abs(motions).T @ np.abs(robot.mass_matrix(q)).max(axis=1)
    change = np.abs(motions.T @ (forces - robot.force_elements(q, still)))
    return float((change / np.maximum(largest, _MIN_MOMENTUM)).max(initial=0.0))
