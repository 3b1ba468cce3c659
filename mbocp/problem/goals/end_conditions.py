"""Whether an exact goal can be met: rates on the constraints, and fewer conditions than controls; rest.

Rest at the end: without a limit of jerk an acceleration may end at once, and so may the last one of a motion.
With one it may not: a joint that stands still and still decelerates would move on.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, BoolArray, null_space
from mbocp._tolerances import BOUND_TOLERANCE, RANK_TOLERANCE
from mbocp.exceptions import InconsistentStart, OverdeterminedGoal
from mbocp.mechanisms.consistent_states import CONSISTENCY_TOLERANCE, span_allowed_velocities, tangent_space
from mbocp.problem.first_motion import find_holding_controls, forces_at
from mbocp.problem.goals.end_control import EndControl
from mbocp.problem.goals.frames import frame_rates, pose_jacobian, rate_jacobian
from mbocp.problem.goals.goal import Goal
from mbocp.problem.limits import Bounds
from mbocp.problem.timeline.switches import SwitchTable
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
    reachable = rows @ span_allowed_velocities(robot, goal.q)
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
    counts = _independent_conditions(robot, goal)
    mobility, most = robot.nv - robot.nc, max(counts[:2])
    if most > mobility:
        raise OverdeterminedGoal(
            f"goal: {most} independent exact end conditions on {mobility} "
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


def _independent_conditions(robot: Robot, goal: Goal) -> tuple[int, int, int]:
    """Count independent conditions on configurations, on rates and on accelerations."""
    if goal.rate == "v" and not (robot.nc or robot.drives or goal.frames):  # each is on one entry of v
        q, v, a = (int(active.sum()) for active in (goal.q_active, goal.rate_active, goal.a_active))
        return q, v, a
    P, allowed = tangent_space(robot, goal.q), span_allowed_velocities(robot, goal.q)
    rates = _rate_matrix(robot, goal) @ allowed
    return (
        _rank(np.vstack([P[goal.q_active], pose_jacobian(robot, goal) @ P])),
        _rank(np.vstack([rates[goal.rate_active], rate_jacobian(robot, goal) @ allowed])),
        _rank(P[goal.a_active]),
    )


def _rate_matrix(robot: Robot, goal: Goal) -> Array:
    """Matrix that maps v to the rate of the goal: v itself, or the momentum p."""
    return robot.mass_matrix(goal.q) if goal.rate == "p" else np.eye(robot.nv)


def _rank(matrix: Array) -> int:
    return int(np.linalg.matrix_rank(matrix, tol=RANK_TOLERANCE)) if matrix.size else 0


def free_at_end(robot: Robot, switches: SwitchTable | None, q: Array) -> Array:
    """Directions of velocities that the constraints of the last step leave at q, shape (nv, any)."""
    if switches is None:
        return tangent_space(robot, q)
    return null_space(switches.at_end(q, of_rates=True), RANK_TOLERANCE)


def at_rest(robot: Robot, goal: Goal, limits: Bounds, free: Array) -> Goal:
    """Return the goal with a = 0 for each joint that stops and whose jerk is limited.

    A goal that says something of accelerations stays as it is. So does one whose accelerations the controls
    cannot set at its end, see `mbocp.cli.check.words_of_rest`.

    Parameters
    ----------
    robot : Robot
    goal : Goal
    limits : Bounds
        At the end.
    free : ndarray, shape (nv, any)
        Directions of velocities that the constraints at the end allow.
    """
    if goal.a_rule == "rest":  # of the problem that this one was made from
        goal = replace(goal, a_active=np.zeros(robot.nv, dtype=np.bool_), a_rule="given")
    stops = stops_at_end(robot, goal, limits, free)
    is_said = goal.a_rule == "free" or goal.a_active.any()
    if is_said or not stops.any() or not _is_set(robot, goal, stops, free):
        return goal
    return replace(goal, a_active=stops, a_rule="rest")


def accelerations_at_end(robot: Robot, goal: Goal, a_start: Array) -> tuple[Array, BoolArray]:
    """Accelerations to which limits of jerk lead, and which there are, shape (nv,).

    A cycle goes on with those that it begins with, unless the goal says others, or that they are free.
    """
    if goal.periodic is None or goal.periodic.impact or goal.a_rule == "free":
        return goal.a, goal.a_active
    image = goal.periodic.image(robot).velocity(a_start)
    return np.where(goal.a_active, goal.a, image), np.ones_like(goal.a_active)


def stops_at_end(robot: Robot, goal: Goal, limits: Bounds, free: Array) -> BoolArray:
    """Velocity components that end at zero and have a limit of jerk, shape (nv,)."""
    limited = limits.finite("j")
    return _stops(robot, goal, free) & limited if limited.any() else limited


def stops_whole(robot: Robot, goal: Goal) -> bool:
    """Whether a goal says that all of the robot ends at rest."""
    is_whole = goal.periodic is None and goal.is_exact
    return is_whole and bool(_stops(robot, goal, tangent_space(robot, goal.q)).all())


def says_whole(robot: Robot, goal: Goal) -> bool:
    """Whether a goal says where all joints end; poses of frames do not, which several configurations have."""
    free = tangent_space(robot, goal.q)
    return _find_scaled_rank(np.eye(robot.nv)[goal.q_active] @ free) == _find_scaled_rank(free)


def holds_anywhere(robot: Robot) -> bool:
    """Whether controls, one for each velocity of an open chain, hold the robot wherever it is."""
    if robot.nc or robot.drives or robot.nu != robot.nv or not robot.actuation.is_constant:
        return False
    return _find_scaled_rank(robot.actuation_matrix(robot.q0)) == robot.nv


def controls_at(robot: Robot, said: EndControl, limits: Bounds, q: Array, *, rests: bool) -> Array | None:
    """Return the controls before a start, or after an end; None where they are free.

    Those that hold a robot at rest are free, too, where several do, or none within their limits.

    Parameters
    ----------
    robot : Robot
    said : EndControl
    limits : Bounds
        There.
    q : ndarray, shape (nq,)
        Configuration there.
    rests : bool
        Whether the robot is at rest there.

    Returns
    -------
    u : ndarray, shape (nu,), optional
        [N, N m, and the units of drives].
    """
    if said.rule == "given":
        return said.value
    has_one = said.rule == "rest" and rests and not robot.drives
    if not has_one or null_space(forces_at(robot, q), RANK_TOLERANCE).size:
        return None
    u = find_holding_controls(robot, q)
    if (
        u is None
        or (u < limits.u_lower - BOUND_TOLERANCE).any()
        or (u > limits.u_upper + BOUND_TOLERANCE).any()
    ):
        return None
    return u


def _stops(robot: Robot, goal: Goal, free: Array) -> BoolArray:
    """Velocity components that end at zero, shape (nv,)."""
    none = np.zeros(robot.nv, dtype=np.bool_)
    if not goal.is_exact:
        return none
    asked = goal.rate_active
    rests = not goal.value[asked].any()
    stops = asked & (goal.value == 0.0) if goal.rate == "v" else np.full(robot.nv, asked.all() and rests)
    rows = np.vstack([np.eye(robot.nv)[stops], rate_jacobian(robot, goal)]) @ free
    if (
        rests and not frame_rates(goal).any() and _find_scaled_rank(rows) == _find_scaled_rank(free)
    ):  # frames stop every joint
        stops = ~none
    return stops


def _is_set(robot: Robot, goal: Goal, stops: BoolArray, free: Array) -> bool:
    """Whether controls set the accelerations of these joints at the goal, each by itself."""
    if robot.drives:
        return False
    inertia = free.T @ robot.mass_matrix(goal.q) @ free
    pushed = free @ np.linalg.solve(inertia, free.T @ robot.actuation_matrix(goal.q))
    return _find_scaled_rank(pushed[stops]) == _find_scaled_rank(free[stops])


def _find_scaled_rank(matrix: Array) -> int:
    return int(np.linalg.matrix_rank(matrix, tol=RANK_TOLERANCE * max(1.0, np.abs(matrix).max(initial=0.0))))
