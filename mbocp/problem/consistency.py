"""Whether a state fits the robot's holonomic constraints, and whether an exact goal can be met at all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mbocp._arrays import Array
from mbocp._linear import null_space
from mbocp.exceptions import InconsistentStart, OverdeterminedGoal
from mbocp.problem.goal import Goal
from mbocp.robot import Robot
from mbocp.robot.closing import violations
from mbocp.robot.redundancy import singular_pose

__all__ = [
    "CONSISTENCY_TOLERANCE",
    "check_end_conditions",
    "check_goal_rate",
    "check_position",
    "check_velocity",
    "project_on_constraints",
    "tangent_space",
]

# A start typed with nine digits is accepted; one that is off by what a person can measure is not. The first
# step of the mechanics removes what is left.
CONSISTENCY_TOLERANCE = 1e-8  # [m, rad, m^2 for a rod, and their rates]

_RANK_TOLERANCE = 1e-9  # singular values below this part of the largest count as zero
_PROJECTION_STEPS = 30  # Gauss-Newton is quadratic here: six are typical


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
    for _ in range(_PROJECTION_STEPS):
        residual = robot.constraint_residual(q)
        if np.abs(residual).max() < 1e-14:  # round-off of some metres
            break
        step = np.zeros(robot.nv)
        dPhi_dq = robot.constraint_jacobian(q)[:, free]
        step[free] = -np.linalg.lstsq(dPhi_dq, residual, rcond=_RANK_TOLERANCE)[0]
        q = robot.integrate(q, step)
    return q


def check_goal_rate(robot: Robot, goal: Goal) -> None:
    """Refuse an exact end velocity or momentum that no motion on the constraints has."""
    if not robot.nc or not goal.rate_active.any():
        return
    wanted = np.flatnonzero(goal.rate_active)
    value = goal.value[wanted]
    reachable = (_rate_matrix(robot, goal) @ tangent_space(robot, goal.q))[wanted]
    nearest = reachable @ np.linalg.lstsq(reachable, value, rcond=_RANK_TOLERANCE)[0]
    error = np.abs(nearest - value)
    worst = int(error.argmax())
    if error[worst] <= CONSISTENCY_TOLERANCE * max(1.0, np.abs(value).max()):
        return
    label = (robot.p_labels if goal.rate == "p" else robot.v_labels)[wanted[worst]]
    names = ", ".join(repr(constraint.name) for constraint in robot.constraint_labels)
    raise InconsistentStart(
        f"goal.{goal.rate}: no motion on the constraints of robot {robot.name!r} ({names}) has it, the "
        f"nearest differs by {error[worst]:.3g} {label.unit} at {label.name}; give one that is tangential"
    )


def check_end_conditions(robot: Robot, goal: Goal, num_steps: int) -> int:
    """Return how many independent exact end conditions there are; refuse more than the controls can meet.

    On a constrained system the conditions are projected on the null space P of dPhi_dq at the goal, Eq. (14),
    which drops those that the constraint already implies: what counts is the rank of S P for the selected
    rows S, and of S M P where they are rows of the momentum. Velocities lie in the directions of the drives
    where there are any. At a singular configuration P has more directions than the mechanism has degrees of
    freedom, and no motion meets conditions on all of them.
    """
    if not goal.is_exact:
        return 0
    P = tangent_space(robot, goal.q)
    rates = _rate_matrix(robot, goal) @ _velocities(robot, goal.q)
    counts = _rank(P[goal.q_active]), _rank(rates[goal.rate_active])
    mobility = robot.nv - robot.nc
    if max(counts) > mobility:
        raise OverdeterminedGoal(
            f"goal: {max(counts)} independent exact end conditions on {mobility} "
            f"degree{'s' * (mobility != 1)} of freedom: {singular_pose(robot, goal.q)}; move goal.q away "
            'from such a singular pose, give fewer joints in the goal, or say enforce = "penalty"'
        )
    count = sum(counts)
    available = num_steps * robot.nu
    if count > available:
        raise OverdeterminedGoal(
            f"goal: {count} independent exact end conditions, but {num_steps} step{'s' * (num_steps != 1)} "
            f"with {robot.nu} control{'s' * (robot.nu != 1)} can meet at most {available}; raise "
            'horizon.steps, give fewer joints in the goal, or say enforce = "penalty"'
        )
    return count


def _rate_matrix(robot: Robot, goal: Goal) -> Array:
    """Return what takes a velocity to what the goal speaks of."""
    return robot.mass_matrix(goal.q) if goal.rate == "p" else np.eye(robot.nv)


def _violates(robot: Robot, row: str, value: float, unit: str, key: str, advice: str) -> InconsistentStart:
    return InconsistentStart(
        f"{key}: violates constraint {row!r} of robot {robot.name!r} by {value:.3g} {unit} (allowed: "
        f"{CONSISTENCY_TOLERANCE:g}); {advice}"
    )


def tangent_space(robot: Robot, q: Array) -> Array:
    """Orthonormal basis of the velocities that the constraints allow at q, shape (nv, nv - rank).

    From an SVD, for any constraint: the closed form (46) of the paper is singular where q_x = q_z = 0.
    """
    if not robot.nc:
        return np.eye(robot.nv)
    return null_space(robot.constraint_jacobian(q), _RANK_TOLERANCE)


def _velocities(robot: Robot, q: Array) -> Array:
    """Directions that span the velocities which constraints and drives allow at q, shape (nv, any)."""
    if not robot.drives:
        return tangent_space(robot, q)
    driven: Array = np.hstack([robot.speed_map(q), robot.control_velocity_map(q)])
    if robot.nc:
        driven = driven @ null_space(robot.constraint_jacobian(q) @ driven, _RANK_TOLERANCE)
    return driven


def _rank(matrix: Array) -> int:
    return int(np.linalg.matrix_rank(matrix, tol=_RANK_TOLERANCE)) if matrix.size else 0
