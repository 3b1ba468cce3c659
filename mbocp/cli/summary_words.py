"""How far the end of a motion is from its goal, and its steps from the motion of the robot, in words."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.text import Text

from mbocp._arrays import Array, BoolArray
from mbocp.robot.parts import Label

if TYPE_CHECKING:
    from mbocp.problem import Goal, Problem
    from mbocp.robot import Robot
    from mbocp.solution import Accuracy, Solution


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


def coarse_words(solution: Solution) -> Text:
    """What has to be known before everything else: that the steps are too long for the motion."""
    found = solution.accuracy
    if not found.is_known or found.is_small:
        return Text()
    words = (
        f"the errors of the steps are {_percent(found.share)} of the way of {found.way_joint}: a robot "
        "under these controls moves otherwise; take more steps, or a scheme of higher order (see accuracy)"
    )
    return Text(words, style="bold yellow")


def _feedback(found: Accuracy, size: Callable[[float, str], str]) -> list[str]:
    """What a feedback leaves of the errors."""
    if math.isnan(found.tracked_error):
        return []
    if math.isinf(found.tracked_error):
        return ["with the feedback of the optimum, held over each step, errors grow too fast to be told"]
    missed = size(found.tracked_error, found.tracked_joint)
    return [f"with the feedback of the optimum they miss it by {missed}"]


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 1.0 else f"{100 * share:.0f} %"


def accuracy_words(solution: Solution) -> str:
    """Errors of single steps, of their sum, and of a replay."""
    found = solution.accuracy
    if not found.is_known:
        return ""
    units = {column.name: column.unit.removesuffix("/s") for column in solution.labels.v}
    units |= {column.name: column.unit for column in solution.labels.q}  # not root_joint.rx

    def size(value: float, joint: str) -> str:
        return f"{value:.2g} {units.get(joint, 'rad' * bool(joint))}".rstrip() + f" ({joint})"

    missed = "more than can be told, for errors grow too fast"
    if math.isfinite(found.replay_error):
        missed = size(found.replay_error, found.replay_joint)
    lines = [
        *_horizon_and_solver(solution),
        f"a step is wrong by {size(found.local_error, found.local_joint)} at most, to t = "
        f"{found.local_time:.4g} s; all of them by {_percent(found.share)} of the way of {found.way_joint}",
        f"the controls alone, without feedback, miss the end by {missed}",
        *_feedback(found, size),
        f"the steps {'make' if found.made_energy > 0.0 else 'lose'} {abs(found.made_energy):.2g} J of "
        f"{found.energy_range:.3g} J",
    ]
    return "\n".join(lines)


def _horizon_and_solver(solution: Solution) -> list[str]:
    """What was asked for, and how many steps it took."""
    found = solution.accuracy
    if math.isnan(found.asked):
        return []
    rounds = "1 round" if found.rounds == 1 else f"{found.rounds} rounds"
    lengths = np.diff(solution.t)
    wrong = f"the cost is wrong by {found.cost_error:.1g} of it" if found.cost_error else "the cost is zero"
    return [
        f"{found.asked:g} was asked for: {solution.num_steps} steps of {lengths.min():.3g} to "
        f"{lengths.max():.3g} s, found in {rounds}; {wrong}"
    ]
