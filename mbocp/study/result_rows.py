"""One task's row: what a solution comes to in plain values, or why there is none."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbocp._arrays import plain_json
from mbocp.exceptions import StudyError, suggest
from mbocp.problem import Problem
from mbocp.problem.goals.frames import pose_errors
from mbocp.solution import Solution

# How a task ends that has no solution to show for it, beside the statuses of solutions.
ERROR, TIMEOUT, CRASHED = "error", "timeout", "crashed"

_LIKE_SOLUTION = ("cost", "residual", "constraint_violation", "manifold_drift", "limit_violation")

# Columns of every row, behind its index and what was varied.
FIELDS: tuple[str, ...] = (
    "status",
    "converged",
    "iterations",
    "solver_time_s",
    "total_time_s",
    *_LIKE_SOLUTION,
    "goal_distance",
    "message",
)

NO_SOLVER = ("compile", "guess", "diagnostics")  # phases of a solve in which no solver works
_LETTERS = {"q": "qs", "v": "vs", "p": "ps", "u": "us", "lam": "lams", "mu": "mus", "zeta": "zetas"}
_OF_MOTION = ("q_final", "p_final", "u_first", "u_last", "num_steps", "control_hamiltonian")
_DERIVED = (*_OF_MOTION, "duration", "parameters", "via_times")
_BULKY = ("phases", "history", "labels", "options", "versions", "robot_spec", "problem_text")
_MAX_MESSAGE = 2000  # letters of a message


def check_record(names: Sequence[str]) -> None:
    """Refuse what a row cannot hold.

    Raises
    ------
    StudyError
        Naming the nearest quantities there are.
    """
    for name in names:
        if name not in _recordable():
            raise StudyError(f"record: a solution has no {name!r}: {suggest(name, sorted(_recordable()))}")


def solution_row(
    problem: Problem, solution: Solution, seconds: float, record: Sequence[str] = ()
) -> dict[str, Any]:
    """Row of a task that has a solution, converged or not; `seconds`: all of the task's time [s]."""
    numbers = {name: getattr(solution, name, math.nan) for name in _LIKE_SOLUTION}
    row = {
        "status": str(solution.status),
        "converged": solution.converged,
        "iterations": solution.iterations,
        "solver_time_s": solver_seconds(solution),
        "total_time_s": seconds,
        **numbers,
        "goal_distance": _goal_distance(problem, solution),
        "message": "" if solution.converged else solution.advice[:_MAX_MESSAGE],
    }
    if record:
        row["record"] = {name: _record(solution, name) for name in record}
    return {name: plain_json(value) for name, value in row.items()}


def failure_row(status: str, message: str, seconds: float = math.nan) -> dict[str, Any]:
    """Row of a task without solution: `status` is `ERROR`, `TIMEOUT` or `CRASHED`."""
    row: dict[str, Any] = dict.fromkeys(FIELDS)
    row |= {"status": status, "converged": False, "message": message[:_MAX_MESSAGE]}
    return row | {"total_time_s": plain_json(seconds)}


def solver_seconds(solution: Solution) -> float:
    """Wall time of the solver's phases, without compilation, guess and diagnostics [s]."""
    return sum(phase.wall_time_s for phase in solution.phases if phase.name not in NO_SOLVER)


def _recordable() -> set[str]:
    fields = {field.name for field in dataclasses.fields(Solution)} - {*_BULKY, *_LETTERS.values()}
    return fields | set(_LETTERS) | set(_DERIVED) | {"v_final"}


def _record(solution: Solution, name: str) -> Any:
    return solution.vs[-1] if name == "v_final" else getattr(solution, _LETTERS.get(name, name))


def _goal_distance(problem: Problem, solution: Solution) -> float:
    """Norm of what is left to the goal at the end, over what it says; NaN if that is nothing.

    Of joints the tangent vector from goal to end, of frames distances [m] and angles [rad].
    """
    problem = problem.member(solution.goal_place).with_found(solution.parameters)
    goal = problem.goal
    if not (goal.q_active.any() or goal.poses):
        return math.nan
    difference = problem.robot.difference(goal.q, solution.q_final)
    left = [difference[goal.q_active]]
    if goal.poses:
        errors = pose_errors(problem.robot, goal, solution.q_final)
        left += [errors.positions, errors.angles]
    return float(np.linalg.norm(np.concatenate(left)))
