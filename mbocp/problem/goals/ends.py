"""Start and goal of a problem: checked against the robot and its drives, and completed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp._tolerances import DIRECTION_TOLERANCE
from mbocp.exceptions import MbocpError, ProblemError
from mbocp.mechanisms.completion import complete_goal
from mbocp.mechanisms.consistent_states import check_position, check_velocity
from mbocp.problem._checks import MAX_POSITION, MAX_RATE, check_finite, check_size
from mbocp.problem.goals.end_conditions import at_rest, check_end_conditions, check_goal_rate, free_at_end
from mbocp.problem.goals.frames import check_frames, with_configuration
from mbocp.problem.goals.goal import Goal
from mbocp.problem.integration import check_unused
from mbocp.problem.limits import Bounds, check_within
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.warn import warn_limits, warn_singular
from mbocp.robot import Label, Robot
from mbocp.terms.rates import RATE_TERMS


def check_start_state(robot: Robot, limits: Bounds, q_start: Array, v_start: Array) -> tuple[Array, Array]:
    """Return configuration and velocity of a start, with unit quaternions.

    Raises
    ------
    DimensionMismatch, InvalidValue, InconsistentStart
        If they do not fit the robot, or violate a holonomic constraint or a drive.
    """
    q = frozen_array(q_start, shape=(robot.nq,), name="start.q")
    check_finite("start.q", q)
    v = frozen_array(v_start, shape=(robot.nv,), name="start.v")
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


def check_acceleration(robot: Robot, limits: Bounds, a_start: Array) -> Array:
    """Return the acceleration before a start, zero where none is given.

    Raises
    ------
    DimensionMismatch, InvalidValue, ProblemError
        If it does not fit the robot, is beyond its limits, or controls prescribe velocities.
    """
    given = a_start if np.size(a_start) else np.zeros(robot.nv)
    a = frozen_array(given, shape=(robot.nv,), name="start.a")
    check_finite("start.a", a)
    if robot.drives and a.any():
        raise ProblemError(
            f"start.a: controls prescribe velocities of robot {robot.name!r}, which have no accelerations "
            "before the start; leave it out"
        )
    unit = RATE_TERMS["acceleration"].unit
    check_within(limits, "start", "a", a, [Label(label.name, unit(label.unit)) for label in robot.v_labels])
    return a


def settle_goal(
    robot: Robot,
    said_goal: Goal,
    limits_at_end: Bounds,
    q_start: Array,
    via_in_order: tuple[ViaPoint, ...],
    num_steps: int,
    scheme: str,
    scheme_reason: str,
    switches: SwitchTable | None,
) -> Goal:
    """Return a goal with what its poses and loops leave open: configuration, and rest where joints stop.

    Parameters
    ----------
    q_start : ndarray, shape (nq,)
        Configuration of the start. The goal is to be near it, or near the last via point
        [m, rad, unit quaternion xyzw].
    scheme_reason : str
        What the scheme was chosen for; "" if the problem says it.
    switches : SwitchTable, optional
        Constraints that hold at the end.

    Raises
    ------
    DimensionMismatch, InvalidValue, InconsistentStart, UnreachableGoal, UnreachablePose, OverdeterminedGoal
        If it does not fit the robot, or cannot be met.
    """
    said_goal.check_dimensions(robot.nq, robot.nv)
    goal = _with_configuration(said_goal, robot.normalise(said_goal.q, name="goal.q"))
    if goal.periodic is not None:
        goal.periodic.check(robot)
    check_size("goal.q", goal.q, robot.q_labels, MAX_POSITION)
    rates = robot.p_labels if goal.rate == "p" else robot.v_labels
    check_size(f"goal.{goal.rate}", goal.value, rates, MAX_RATE)
    check_frames(robot, goal)
    q_before = via_in_order[-1].goal.q if via_in_order else q_start
    goal = with_configuration(robot, goal, q_before, limits_at_end)
    goal = without_driven_velocities(robot, goal)
    for key, default in (("guard", True), ("redundant", "drop")):
        check_unused(f"goal.{key}", getattr(goal, key), default, scheme, suits=scheme_reason)
    if goal.is_exact:
        goal = _with_configuration(goal, complete_goal(robot, goal.q, goal.q_active, q_start))
        check_goal_rate(robot, goal)
        check_driven_rate(robot, goal)
        check_driven_acceleration(robot, goal)
        check_end_conditions(robot, goal, num_steps)
        warn_singular(robot, goal.q, "goal.q")
    if goal.periodic is not None and not goal.poses:  # where guesses end
        closes_loops = switches is None or bool(switches.own[-1].all())
        goal = replace(goal, q=goal.periodic.guess(robot, q_start, closes_loops=closes_loops))
    if goal.q_active.any() or goal.poses:
        warn_limits(robot, limits_at_end, goal.q, "goal.q")
    rests = at_rest(robot, goal, limits_at_end, free_at_end(robot, switches, goal.q))
    if rests.a_rule == "rest":  # more conditions than what was said
        check_end_conditions(robot, rests, num_steps)
    return rests


def _with_configuration(goal: Goal, q: Array) -> Goal:
    """The goal itself if it has this configuration, as most do."""
    return goal if q.shape == goal.q.shape and q.tobytes() == goal.q.tobytes() else replace(goal, q=q)


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
