"""Start and goal of a problem: checked against the robot and its drives, and completed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp._tolerances import DIRECTION_TOLERANCE
from mbocp.exceptions import DimensionMismatch, MbocpError, ProblemError
from mbocp.mechanisms.completion import complete_goal
from mbocp.mechanisms.consistent_states import check_position, check_velocity
from mbocp.problem._checks import MAX_POSITION, MAX_RATE, check_finite, check_size
from mbocp.problem.goals.consistency import check_end_conditions, check_goal_rate
from mbocp.problem.goals.frames import check_frames, with_configuration
from mbocp.problem.goals.goal import Goal
from mbocp.problem.integration import check_unused
from mbocp.problem.limits import Bounds, check_within
from mbocp.problem.warn import warn_limits, warn_singular
from mbocp.robot import Label, Robot
from mbocp.terms import RATE_TERMS


def checked_start(robot: Robot, limits: Bounds, q_start: Array, v_start: Array) -> tuple[Array, Array]:
    """Return configuration and velocity of a start, with unit quaternions.

    Raises
    ------
    DimensionMismatch, InvalidValue, InconsistentStart
        If they do not fit the robot, or violate a holonomic constraint or a drive.
    """
    q = frozen_array(q_start, name="start.q")
    if q.shape != (robot.nq,):
        raise DimensionMismatch("start.q", q.shape, (robot.nq,))
    check_finite("start.q", q)
    v = frozen_array(v_start, name="start.v")
    if v.shape != (robot.nv,):
        raise DimensionMismatch("start.v", v.shape, (robot.nv,))
    check_finite("start.v", v)
    q = frozen_array(robot.normalise(q, name="start.q"))
    check_size("start.q", q, robot.q_labels, MAX_POSITION)
    check_size("start.v", v, robot.v_labels, MAX_RATE)
    check_position(robot, q, "start.q")
    check_velocity(robot, q, v, "start")
    check_driven_start(robot, q, v)
    warn_limits(robot, limits, q, "start.q")
    warn_singular(robot, q, "start.q")
    return q, v


def checked_acceleration(robot: Robot, limits: Bounds, a_start: Array) -> Array:
    """Return the acceleration before a start, zero where none is given.

    Raises
    ------
    DimensionMismatch, InvalidValue, ProblemError
        If it does not fit the robot, is beyond its limits, or controls prescribe velocities.
    """
    a = frozen_array(a_start if np.size(a_start) else np.zeros(robot.nv), name="start.a")
    if a.shape != (robot.nv,):
        raise DimensionMismatch("start.a", a.shape, (robot.nv,))
    check_finite("start.a", a)
    if robot.drives and a.any():
        raise ProblemError(
            f"start.a: controls prescribe velocities of robot {robot.name!r}, which have no accelerations "
            "before the start; leave it out"
        )
    unit = RATE_TERMS["acceleration"].unit
    check_within(limits, "start", "a", a, [Label(label.name, unit(label.unit)) for label in robot.v_labels])
    return a


def completed_goal(
    robot: Robot,
    goal: Goal,
    limits: Bounds,
    q_start: Array,
    q_before: Array,
    *,
    num_steps: int,
    scheme: str,
    suits: str = "",
    closes_loops: bool = True,
) -> Goal:
    """Return a goal with the configuration that its poses and loops leave open.

    Parameters
    ----------
    q_start, q_before : ndarray, shape (nq,)
        Configuration of the start, and the last that is known before the goal, of which the goal is to be
        near: that of a via point, or of the start [m, rad, unit quaternion xyzw].
    suits : str
        What the scheme was chosen for; "" if the problem says it.
    closes_loops : bool
        Whether all constraints of the robot hold at the end.

    Raises
    ------
    DimensionMismatch, InvalidValue, InconsistentStart, UnreachableGoal, UnreachablePose, OverdeterminedGoal
        If it does not fit the robot, or cannot be met.
    """
    goal.check_dimensions(robot.nq, robot.nv)
    goal = replace(goal, q=robot.normalise(goal.q, name="goal.q"))
    if goal.periodic is not None:
        goal.periodic.check(robot)
    check_size("goal.q", goal.q, robot.q_labels, MAX_POSITION)
    rates = robot.p_labels if goal.rate == "p" else robot.v_labels
    check_size(f"goal.{goal.rate}", goal.value, rates, MAX_RATE)
    check_frames(robot, goal)
    goal = with_configuration(robot, goal, q_before, limits)
    goal = without_driven_velocities(robot, goal)
    for key, default in (("guard", True), ("redundant", "drop")):
        check_unused(f"goal.{key}", getattr(goal, key), default, scheme, suits=suits)
    if goal.is_exact:
        goal = replace(goal, q=complete_goal(robot, goal.q, goal.q_active, q_start))
        check_goal_rate(robot, goal)
        check_driven_rate(robot, goal)
        check_driven_acceleration(robot, goal)
        check_end_conditions(robot, goal, num_steps)
        warn_singular(robot, goal.q, "goal.q")
    if goal.periodic is not None and not goal.poses:  # where guesses end
        goal = replace(goal, q=goal.periodic.guess(robot, q_start, closes_loops=closes_loops))
    if goal.q_active.any() or goal.poses:
        warn_limits(robot, limits, goal.q, "goal.q")
    return goal


def check_driven_start(robot: Robot, q: Array, v: Array) -> None:
    """Refuse a velocity that the drives do not allow."""
    if not robot.drives:
        return
    try:
        robot.speeds(q, v)
    except MbocpError as error:
        raise ProblemError(f"start.v: {error}") from error


def without_driven_velocities(robot: Robot, goal: Goal) -> Goal:
    """Return the goal without velocities that are controls: those of the last step end with it.

    Raises
    ------
    ProblemError
        If the goal gives one of them that is not zero, or gives momenta.
    """
    if not robot.drives or not goal.rate_active.any():
        return goal
    if goal.rate == "p":
        raise ProblemError(
            f"goal.p: controls of robot {robot.name!r} prescribe velocities "
            f"({', '.join(drive.name for drive in robot.drives)}); give v"
        )
    active = np.array(goal.rate_active)
    for drive in robot.drives:
        if drive.control != "velocity":
            continue
        for i in drive.dofs:
            if active[i] and goal.value[i] != 0.0:
                raise ProblemError(
                    f"goal.v: got {goal.value[i]:g} for {robot.v_labels[i].name}, whose velocity is the "
                    f"control {drive.name!r} and no state that an end condition could hold; leave it out"
                )
            active[i] = False
    return replace(goal, rate_active=active)


def check_driven_acceleration(robot: Robot, goal: Goal) -> None:
    """Refuse accelerations at the end of a robot whose velocities controls prescribe."""
    if robot.drives and goal.a_active.any():
        raise ProblemError(
            f"goal.a: controls prescribe velocities of robot {robot.name!r}, which are no states and have no "
            "accelerations at the end; leave it out"
        )


def check_driven_rate(robot: Robot, goal: Goal) -> None:
    """Refuse an exact end velocity that no speeds of the drives make up."""
    if not robot.drives or not goal.q_active.all() or not goal.rate_active.any():
        return
    asked = np.flatnonzero(goal.rate_active)
    rows, value = robot.speed_map(goal.q)[asked], goal.value[asked]
    error = np.abs(rows @ np.linalg.lstsq(rows, value, rcond=None)[0] - value)
    worst = int(error.argmax())
    if error[worst] > DIRECTION_TOLERANCE * max(1.0, float(np.abs(value).max())):
        label = robot.v_labels[asked[worst]]
        raise ProblemError(
            f"goal.v: the drives of robot {robot.name!r} allow no velocity like this, the nearest differs by "
            f"{error[worst]:.3g} {label.unit} at {label.name}; give one in their directions"
        )
