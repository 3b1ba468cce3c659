"""Accuracy of a solution: whether it is quick to tell, and what is said of a motion whose steps are wrong."""

from __future__ import annotations

import time

import numpy as np

from mbocp.accuracy.errors import accuracy_of
from mbocp.exceptions import CompilationTimeout
from mbocp.formulation import Motion
from mbocp.formulation.wrong_steps import TOLD_STEP, WRONG_STEP, tells_wrong_step, words_of_wrong_step
from mbocp.problem import Problem
from mbocp.solution import Accuracy, Phase, Solution
from mbocp.solution.later import retold
from mbocp.solvers import Status

_MOST_LOOPS = 16  # constraints, of which more take seconds to write down
_MOST_JOINTS = 30  # velocity components, the same
_MOST_STEPS = 20_000


def follows_fast(problem: Problem) -> bool:
    """Whether the flow of the robot takes no more than a second to compile, and milliseconds to follow."""
    robot = problem.robot
    rows = robot.nc if problem.timeline.switches is None else robot.nc + len(problem.timeline.switches.labels)
    return rows <= _MOST_LOOPS and robot.nv <= _MOST_JOINTS and problem.num_steps <= _MOST_STEPS


def motion_of(solution: Solution) -> Motion:
    """The motion of a solution, with its controls within the steps."""
    own = (solution.u_values, tuple(solution.u_shares.tolist()))
    return Motion(solution.qs, solution.vs, solution.us, np.diff(solution.t), *own)


def with_accuracy(problem: Problem, solution: Solution, deadline: float) -> Solution:
    """The solution with the errors of its motion; as it is without a motion or time, or with free feet.

    Ctrl-C leaves the solution, `interrupted`.
    """
    table = problem.timeline.switches
    if not solution.is_stationary or (table is not None and table.free_feet):
        return solution
    begun = time.perf_counter()
    motion = motion_of(solution)
    try:
        found = accuracy_of(
            problem.with_found(solution.parameters).robot,
            motion,
            table=table,
            gains=solution.gains,
            deadline=deadline,
        )
    except CompilationTimeout:
        return solution
    except KeyboardInterrupt:
        words = f"interrupted before its accuracy was known; {solution.advice}"
        return retold(solution, status=Status.INTERRUPTED, advice=words)
    spent = time.perf_counter() - begun
    phases = (*solution.phases, Phase("accuracy", 0, spent))
    status, advice = _judge(problem, solution, found)
    wall_time_s = solution.wall_time_s + spent
    return retold(
        solution, status=status, advice=advice, accuracy=found, phases=phases, wall_time_s=wall_time_s
    )


def _judge(problem: Problem, solution: Solution, found: Accuracy) -> tuple[Status, str]:
    """Status and advice of a motion whose steps are known to be wrong by so much."""
    turns = {label.name for label in problem.robot.move_labels if label.unit == "rad"}
    words = words_of_wrong_step(found.local_error, found.local_joint, found.local_time, solution.scheme)
    if not (found.local_error > TOLD_STEP and found.local_joint in turns):
        return solution.status, solution.advice
    if not (found.local_error > WRONG_STEP and solution.converged):
        is_told = tells_wrong_step(solution.advice)
        return solution.status, solution.advice if is_told else f"{solution.advice}; {words}"
    return Status.UNDER_RESOLVED, f"{words}; the optimality conditions hold: {solution.advice}"
