"""Solutions that say how accurate they are."""

from __future__ import annotations

import time

import numpy as np

from mbocp.accuracy.errors import accuracy_of
from mbocp.exceptions import CompilationTimeout
from mbocp.formulation import Motion
from mbocp.problem import Problem
from mbocp.solution import Phase, Solution
from mbocp.solution.later import retold

_MOST_LOOPS = 6  # constraints, of which more take seconds to compile
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
    """The solution with the errors of its motion; as it is where there is no motion or no time."""
    if not solution.is_stationary:
        return solution
    begun = time.perf_counter()
    motion = motion_of(solution)
    try:
        found = accuracy_of(
            problem.with_found(solution.parameters).robot,
            motion,
            table=problem.timeline.switches,
            gains=solution.gains,
            deadline=deadline,
        )
    except CompilationTimeout:
        return solution
    spent = time.perf_counter() - begun
    phases = (*solution.phases, Phase("accuracy", 0, spent))
    return retold(solution, accuracy=found, phases=phases, wall_time_s=solution.wall_time_s + spent)
