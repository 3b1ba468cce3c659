"""How far the end of a motion is from its goal, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.robot.parts import Label

if TYPE_CHECKING:
    from mbocp.problem import Goal, Problem
    from mbocp.robot import Robot
    from mbocp.solution import Solution


def goal_error(solution: Solution, problem: Problem) -> str:
    """Say how far the end is from the goal, in the worst direction of position and of velocity."""
    robot, goal = problem.robot, problem.member(solution.goal_place).goal
    if goal.enforce == "none":
        return ""
    of_v = robot.v_labels
    parts = []
    if goal.q_active.any():
        away = robot.difference(goal.q, solution.q_final)
        parts.append(f"off by {_worst(away, goal.q_active, robot.move_labels)}")
    if goal.rate == "p" and goal.rate_active.any():
        away = solution.p_final - goal.value
        parts.append(f"momentum by {_worst(away, goal.rate_active, robot.p_labels)}")
    elif goal.rate_active.any():
        parts.append(f"velocity by {_worst(solution.vs[-1] - goal.value, goal.rate_active, of_v)}")
    if problem.sets_acceleration.any():
        of_a = [Label(label.name, f"{label.unit}^2") for label in of_v]
        away = solution.accelerations[-1] - goal.a
        parts.append(f"acceleration by {_worst(away, problem.sets_acceleration, of_a)}")
    if goal.periodic is not None:
        parts.append(_cycle_error(solution, problem))
    return ", ".join([*parts, *_frames_off(robot, goal, solution.q_final)])


def _worst(away: Array, asked: BoolArray, labels: Sequence[Label]) -> str:
    """Size of the largest error among those that count, and where it is."""
    worst = int(np.abs(np.where(asked, away, 0.0)).argmax())
    return f"{abs(away[worst]):.2e} {labels[worst].unit} at {labels[worst].name}"


def _frames_off(robot: Robot, goal: Goal, q: Array) -> Iterator[str]:
    if not goal.poses:
        return
    from mbocp.problem.goals.frames import pose_errors

    errors = pose_errors(robot, goal, q)
    for frame, distance, angle in zip(goal.poses, errors.positions, errors.angles, strict=True):
        yield f"{frame.name} off by {1e3 * distance:.2e} mm and {np.degrees(angle):.2e} deg"


def _cycle_error(solution: Solution, problem: Problem) -> str:
    """How far the end is from the image of the start."""
    robot, periodic = problem.robot, problem.member(solution.goal_place).goal.periodic
    if periodic is None:
        return ""
    start, end = ((solution.qs[n], solution.vs[n]) for n in (0, -1))
    defect = periodic.defect(robot, start, end)
    worst = int(np.abs(defect).argmax())
    label = (*robot.move_labels, *robot.v_labels)[worst]
    words = f"a cycle, closed to {abs(defect[worst]):.2e} {label.unit} at {label.name}"
    apart = [
        f"{name} moves by {(end[0] - start[0])[robot.configuration_indices(name)].item():.6g}"
        for name in periodic.apart
        if robot.velocity_indices(name).stop - robot.velocity_indices(name).start == 1
        and robot.configuration_indices(name).stop - robot.configuration_indices(name).start == 1
    ]
    return "; ".join([words, *apart])
