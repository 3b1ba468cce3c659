"""Goals of frames near obstacles: a configuration there that keeps all margins, if one is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbocp._arrays import Array
from mbocp.problem.goals.frames import goal_branches, goal_near
from mbocp.problem.goals.goal import Goal
from mbocp.problem.limits import Bounds
from mbocp.problem.obstacles.clearance import Clearance
from mbocp.robot import Robot
from mbocp.robot.nodes import move

_BRANCHES, _RESTARTS = 24, 96  # of the search; a redundant arm has as many branches as one looks for
_CLIMBS, _TRIES = 3, 12  # from the best of them, with so many neighbours a step
_WIDTHS = 0.3 * 0.75 ** np.arange(16)  # [rad, m] of the steps of a climb


def clear_configuration(
    robot: Robot, goal: Goal, q_start: Array, limits: Bounds, clearance: Clearance
) -> Goal:
    """The goal, with another `q` where frames alone say where it is and its own keeps a margin not.

    It is the nearest to the start of the configurations that keep all margins. Where none is found the goal
    is as it was, and so is that of a robot with closed loops, whose other configurations it may not get to.
    """
    if clearance.least(goal.q[None])[0] >= 0.0:
        return goal
    q, room, _ = clearest(robot, goal, q_start, limits, clearance)
    return replace(goal, q=q) if room >= 0.0 else goal


def clearest(
    robot: Robot, goal: Goal, q_start: Array, limits: Bounds, clearance: Clearance
) -> tuple[Array, float, int]:
    """The nearest configuration at a goal that keeps all margins, or else the one that misses them by least.

    Where none of many branches keeps them, the best ones climb: of random neighbours, each brought back to
    the goal or somewhere within its tolerances, the clearest is the next one.

    Returns
    -------
    q : ndarray, shape (nq,)
    room : float
        What is left beyond the margins there [m]; NaN where frames alone do not say the goal.
    count : int
        How many configurations were looked at.
    """
    is_free = bool(goal.poses) and goal.enforce != "none" and not goal.q_active.all()
    if robot.nc or not is_free:
        return goal.q, np.nan, 0
    found = goal_branches(robot, goal, q_start, limits, _BRANCHES, _RESTARTS)
    if not found.reached:
        return goal.q, np.nan, 0
    room, count, rng = clearance.least(found.branches), len(found.branches), np.random.default_rng(0)
    if (room >= 0.0).any():
        first = int((room >= 0.0).argmax())
        return found.branches[first], float(room[first]), count
    best = goal.q, -np.inf
    for k in np.argsort(-room, kind="stable")[:_CLIMBS]:
        at = found.branches[k], float(room[k])
        for width in _WIDTHS:
            tried = _neighbours(robot, goal, at[0], limits, width, rng)
            rooms, count = clearance.least(tried) if len(tried) else np.full(1, -np.inf), count + len(tried)
            at = (tried[rooms.argmax()], float(rooms.max())) if rooms.max() > at[1] else at
            if at[1] >= 0.0:
                return (*at, count)
        best = at if at[1] > best[1] else best
    return (*best, count)


def _neighbours(
    robot: Robot, goal: Goal, q: Array, limits: Bounds, width: float, rng: np.random.Generator
) -> Array:
    """Configurations at a goal about one, shape (n, nq)."""
    steps = width * rng.standard_normal((_TRIES, robot.nv))
    goals = [replace(goal, frames=tuple(frame.move_within(rng) for frame in goal.frames)) for _ in steps]
    places = move(robot, np.tile(q, (_TRIES, 1)), steps)
    found = [goal_near(robot, *at, limits) for at in zip(goals, places, strict=True)]
    return np.array([at for at in found if at is not None]).reshape(-1, robot.nq)
