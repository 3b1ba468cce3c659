"""Whether an exact goal can be met: rates on the constraints, and fewer conditions than controls."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.exceptions import InconsistentStart, OverdeterminedGoal
from mbocp.mechanisms.consistency import (
    CONSISTENCY_TOLERANCE,
    allowed_velocities,
    tangent_space,
)
from mbocp.problem.goals.frames import frame_rates, pose_jacobian, rate_jacobian
from mbocp.problem.goals.goal import Goal
from mbocp.robot import Robot
from mbocp.robot.loops.redundancy import singular_pose


def check_goal_rate(robot: Robot, goal: Goal) -> None:
    """Refuse an exact end velocity or momentum that no motion on the constraints has."""
    _check_frame_rates(robot, goal)
    if not robot.nc or not goal.rate_active.any():
        return
    wanted = np.flatnonzero(goal.rate_active)
    value = goal.value[wanted]
    reachable = (_rate_matrix(robot, goal) @ tangent_space(robot, goal.q))[wanted]
    nearest = reachable @ np.linalg.lstsq(reachable, value, rcond=RANK_TOLERANCE)[0]
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


def _check_frame_rates(robot: Robot, goal: Goal) -> None:
    """Refuse velocities of frames that no motion has, together with the goal's velocity or momentum."""
    asked = frame_rates(goal)
    if not asked.size:
        return
    rows = np.vstack([_rate_matrix(robot, goal)[goal.rate_active], rate_jacobian(robot, goal)])
    values = np.concatenate([goal.value[goal.rate_active], asked])
    reachable = rows @ allowed_velocities(robot, goal.q)
    error = np.abs(reachable @ np.linalg.lstsq(reachable, values, rcond=RANK_TOLERANCE)[0] - values)
    if error.max() > CONSISTENCY_TOLERANCE * max(1.0, np.abs(values).max()):
        names = ", ".join(repr(frame.name) for frame in goal.frames if frame.rates.size)
        raise InconsistentStart(
            f"goal.frame: no motion of robot {robot.name!r} through the goal gives {names} its velocity (the "
            f"nearest differs by {error.max():.3g}); give one that the joints can make, or fewer conditions"
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
    rates = _rate_matrix(robot, goal) @ allowed_velocities(robot, goal.q)
    velocities = rate_jacobian(robot, goal) @ allowed_velocities(robot, goal.q)
    counts = (
        _rank(np.vstack([P[goal.q_active], pose_jacobian(robot, goal) @ P])),
        _rank(np.vstack([rates[goal.rate_active], velocities])),
    )
    mobility = robot.nv - robot.nc
    if max(counts) > mobility:
        raise OverdeterminedGoal(
            f"goal: {max(counts)} independent exact end conditions on {mobility} "
            f"degree{'s' * (mobility != 1)} of freedom: {singular_pose(robot, goal.q)}; move goal.q away "
            'from such a singular pose, give fewer joints in the goal, or say enforce = "penalty"'
        )
    count = sum(counts) + _rank(P[goal.a_active])
    available = num_steps * robot.nu
    if count > available:
        raise OverdeterminedGoal(
            f"goal: {count} independent exact end conditions, but {num_steps} step{'s' * (num_steps != 1)} "
            f"with {robot.nu} control{'s' * (robot.nu != 1)} can meet at most {available}; raise "
            'horizon.steps, give fewer joints in the goal, or say enforce = "penalty"'
        )
    return count


def _rate_matrix(robot: Robot, goal: Goal) -> Array:
    """Matrix that maps v to the rate of the goal: v itself, or the momentum p."""
    return robot.mass_matrix(goal.q) if goal.rate == "p" else np.eye(robot.nv)


def _rank(matrix: Array) -> int:
    return int(np.linalg.matrix_rank(matrix, tol=RANK_TOLERANCE)) if matrix.size else 0
