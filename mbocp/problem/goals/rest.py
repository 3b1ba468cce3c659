"""Rest at the end: where jerks are limited, a joint that stops has no acceleration left.

Without a limit of jerk an acceleration may end at once, and so may the last one of a motion. With one it may
not: a joint that stands still and still decelerates would move on.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.problem.goals.frames import frame_rates, rate_jacobian
from mbocp.problem.goals.goal import Goal
from mbocp.problem.limits import Bounds
from mbocp.robot import Robot


class _HasEnd(Protocol):
    """What of a `Problem` is asked here."""

    # fmt: off
    @property
    def robot(self) -> Robot: ...
    @property
    def goal(self) -> Goal: ...
    @property
    def limits_of_ends(self) -> tuple[Bounds, Bounds]: ...
    def free_at_end(self, q: Array) -> Array: ...
    # fmt: on


def at_rest(robot: Robot, goal: Goal, limits: Bounds, free: Array) -> Goal:
    """Return the goal with a = 0 for each joint that stops and whose jerk is limited.

    A goal that says something of accelerations stays as it is. So does one whose accelerations the controls
    cannot set at its end, see `words_of_rest`.

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
    stops = _stops(robot, goal, limits, free)
    is_said = goal.a_rule == "free" or goal.a_active.any()
    if is_said or not stops.any() or not _is_set(robot, goal, stops, free):
        return goal
    return replace(goal, a_active=stops, a_rule="rest")


def words_of_rest(problem: _HasEnd) -> str:
    """What a goal of rest says of accelerations where jerks are limited; "" where there is nothing to say."""
    robot, goal = problem.robot, problem.goal
    if goal.a_rule == "rest":
        return "a = 0 since jerk is limited"
    stops = _stops(robot, goal, problem.limits_of_ends[1], problem.free_at_end(goal.q))
    if goal.a_active.any() or not stops.any():
        return ""
    if goal.a_rule == "free":
        return "acceleration free"
    if robot.drives:
        return "acceleration free, since controls prescribe velocities"
    return f"acceleration free: {robot.nu} control{'s' * (robot.nu != 1)} cannot set it"


def _stops(robot: Robot, goal: Goal, limits: Bounds, free: Array) -> BoolArray:
    """Velocity components that end at zero and have a limit of jerk, shape (nv,)."""
    none = np.zeros(robot.nv, dtype=np.bool_)
    limited = limits.finite("j")
    if not (goal.is_exact and limited.any()):
        return none
    asked = goal.rate_active
    rests = not goal.value[asked].any()
    stops = asked & (goal.value == 0.0) if goal.rate == "v" else np.full(robot.nv, asked.all() and rests)
    rows = np.vstack([np.eye(robot.nv)[stops], rate_jacobian(robot, goal)]) @ free
    if rests and not frame_rates(goal).any() and _rank(rows) == _rank(free):  # frames stop every joint
        stops = ~none
    found: BoolArray = stops & limited
    return found


def _is_set(robot: Robot, goal: Goal, stops: BoolArray, free: Array) -> bool:
    """Whether controls set the accelerations of these joints at the goal, each by itself."""
    if robot.drives:
        return False
    inertia = free.T @ robot.mass_matrix(goal.q) @ free
    pushed = free @ np.linalg.solve(inertia, free.T @ robot.actuation_matrix(goal.q))
    return _rank(pushed[stops]) == _rank(free[stops])


def _rank(matrix: Array) -> int:
    return int(np.linalg.matrix_rank(matrix, tol=RANK_TOLERANCE * max(1.0, np.abs(matrix).max(initial=0.0))))
