"""Start and goal of robots whose controls prescribe velocities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbocp._arrays import Array
from mbocp._tolerances import DIRECTION_TOLERANCE
from mbocp.exceptions import MbocpError, ProblemError
from mbocp.problem.goals.goal import Goal
from mbocp.robot import Robot


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
