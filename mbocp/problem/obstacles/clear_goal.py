"""The configuration at the poses of a goal's frames in which the robot touches nothing."""

from __future__ import annotations

from dataclasses import replace

from mbocp._arrays import Array
from mbocp.problem.goals.frames import goal_branches
from mbocp.problem.goals.goal import Goal
from mbocp.problem.limits import Bounds
from mbocp.problem.obstacles.clearance import Clearance
from mbocp.robot import Robot

_BRANCHES, _RESTARTS = 24, 96  # of the search; a redundant arm has as many branches as one looks for


def clear_configuration(
    robot: Robot, goal: Goal, q_start: Array, limits: Bounds, clearance: Clearance
) -> Goal:
    """The goal, with another `q` where frames alone say where it is and its own keeps a margin not.

    It is the nearest to the start of the configurations that keep all margins. Where none is found the goal
    is as it was, and so is that of a robot with closed loops, whose other configurations it may not get to.
    """
    is_free = bool(goal.poses) and goal.enforce != "none" and not goal.q_active.all()
    if robot.nc or not is_free or clearance.least(goal.q[None])[0] >= 0.0:
        return goal
    found = goal_branches(robot, goal, q_start, limits, _BRANCHES, _RESTARTS)
    if not found.reached:
        return goal
    room = clearance.least(found.branches)
    return replace(goal, q=found.branches[int((room >= 0.0).argmax())]) if (room >= 0.0).any() else goal
