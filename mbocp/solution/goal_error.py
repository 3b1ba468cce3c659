"""How far the end of a motion is from its goal, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.formulation import Motion
from mbocp.mechanics.motion_rates import rates_along
from mbocp.problem import Goal, Problem
from mbocp.problem.goals.frames import pose_errors
from mbocp.problem.goals.periodic import Periodic
from mbocp.robot import Robot
from mbocp.robot.parts import Label


def goal_error(problem: Problem, motion: Motion, ps: Array) -> str:
    """Say how far the end is from the goal, in the worst direction of position and of velocity.

    Parameters
    ----------
    problem : Problem
        Of one goal, with the robot that was found.
    motion : Motion
    ps : ndarray, shape (N + 1, nv)
        Momenta [kg m/s, N m s].
    """
    robot, goal, q = problem.robot, problem.goal, motion.qs[-1]
    if goal.enforce == "none":
        return ""
    of_v = robot.v_labels
    parts = []
    if goal.q_active.any():
        away = robot.difference(goal.q, q)
        parts.append(f"off by {_worst(away, goal.q_active, robot.move_labels)}")
    if goal.rate == "p" and goal.rate_active.any():
        away = ps[-1] - goal.value
        parts.append(f"momentum by {_worst(away, goal.rate_active, robot.p_labels)}")
    elif goal.rate_active.any():
        parts.append(f"velocity by {_worst(motion.vs[-1] - goal.value, goal.rate_active, of_v)}")
    if problem.sets_acceleration.any():
        of_a = [Label(label.name, f"{label.unit}^2") for label in of_v]
        away = rates_along(None, motion.qs, motion.vs, motion.us, motion.dts)["acceleration"][-1] - goal.a
        parts.append(f"acceleration by {_worst(away, problem.sets_acceleration, of_a)}")
    if goal.periodic is not None:
        parts.append(_cycle_error(robot, goal.periodic, motion))
    return ", ".join([*parts, *_frames_off(robot, goal, q)])


def _worst(away: Array, asked: BoolArray, labels: Sequence[Label]) -> str:
    """Size of the largest error among those that count, and where it is."""
    worst = int(np.where(asked, np.abs(away), -1.0).argmax())
    return f"{abs(away[worst]):.2e} {labels[worst].unit} at {labels[worst].name}"


def _frames_off(robot: Robot, goal: Goal, q: Array) -> Iterator[str]:
    if not goal.poses:
        return
    errors = pose_errors(robot, goal, q)
    for frame, distance, angle in zip(goal.poses, errors.positions, errors.angles, strict=True):
        yield f"{frame.name} off by {1e3 * distance:.2e} mm and {np.degrees(angle):.2e} deg"


def _cycle_error(robot: Robot, periodic: Periodic, motion: Motion) -> str:
    """How far the end is from the image of the start."""
    start, end = ((motion.qs[n], motion.vs[n]) for n in (0, -1))
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
