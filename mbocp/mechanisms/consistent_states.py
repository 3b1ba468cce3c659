"""Whether a state fits the holonomic constraints, and the velocities that they allow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mbocp._arrays import Array
from mbocp._linear import null_space
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.exceptions import InconsistentStart
from mbocp.robot import Robot
from mbocp.robot.loops.projection import violations

# A start with nine digits is accepted, a measurable violation is not. The first step of the mechanics removes
# the rest.
CONSISTENCY_TOLERANCE = 1e-8  # [m, rad, m^2 for a rod, and their rates]

_MAX_PROJECTION_STEPS = 30  # Gauss-Newton is quadratic here: six are typical


def check_position(robot: Robot, q: Array, key: str) -> None:
    """Refuse a configuration that violates a holonomic constraint."""
    bad = violations(robot, q, CONSISTENCY_TOLERANCE) if robot.nc else []
    if bad:
        table = key.partition(".")[0]
        advice = f"correct q so that the constraint holds, or say {table}.assemble = true for the nearest one"
        raise _violates(robot, *bad[0], key, advice)


def check_velocity(robot: Robot, q: Array, v: Array, key: str) -> None:
    """Refuse a velocity that leaves the constraint manifold."""
    if not robot.nc:
        return
    rate = robot.constraint_jacobian(q) @ v
    worst = int(np.abs(rate).argmax())
    if np.abs(rate[worst]) > CONSISTENCY_TOLERANCE:
        label = robot.constraint_labels[worst]
        advice = (
            "give a velocity or momentum that is tangential to the constraint, or say "
            f"{key}.assemble = true for the nearest one"
        )
        raise _violates(robot, label.name, float(rate[worst]), f"{label.unit}/s", key, advice)


def project_on_constraints(robot: Robot, q: Array, free: NDArray[np.intp]) -> Array:
    """Gauss-Newton on Phi(q) = 0 in the directions `free`."""
    for _ in range(_MAX_PROJECTION_STEPS):
        residual = robot.constraint_residual(q)
        if np.abs(residual).max() < 1e-14:  # round-off of some metres
            break
        step = np.zeros(robot.nv)
        dPhi_dq = robot.constraint_jacobian(q)[:, free]
        step[free] = -np.linalg.lstsq(dPhi_dq, residual, rcond=RANK_TOLERANCE)[0]
        q = robot.integrate(q, step)
    return q


def tangent_space(robot: Robot, q: Array) -> Array:
    """Orthonormal basis of the velocities that the constraints allow at q, shape (nv, nv - rank).

    From an SVD, for any constraint: the closed form (46) of the paper is singular where q_x = q_z = 0.
    """
    if not robot.nc:
        return np.eye(robot.nv)
    return null_space(robot.constraint_jacobian(q), RANK_TOLERANCE)


def allowed_velocities(robot: Robot, q: Array) -> Array:
    """Directions that span the velocities which constraints and drives allow at q, shape (nv, any)."""
    if not robot.drives:
        return tangent_space(robot, q)
    driven: Array = np.hstack([robot.speed_map(q), robot.control_velocity_map(q)])
    if robot.nc:
        driven = driven @ null_space(robot.constraint_jacobian(q) @ driven, RANK_TOLERANCE)
    return driven


def _violates(robot: Robot, row: str, value: float, unit: str, key: str, advice: str) -> InconsistentStart:
    return InconsistentStart(
        f"{key}: violates constraint {row!r} of robot {robot.name!r} by {value:.3g} {unit} (allowed: "
        f"{CONSISTENCY_TOLERANCE:g}); {advice}"
    )
