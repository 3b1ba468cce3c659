"""One task, in the process that solves it: make the problem, solve it, return a row of plain values."""

from __future__ import annotations

import dataclasses
import json
import math
import threading
import time
import warnings
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._arrays import dataclass, plain_json
from mbocp.exceptions import CompilationTimeout, StudyError, suggest
from mbocp.problem import Problem
from mbocp.problem.file.overrides import apply_overrides
from mbocp.problem.goals.frames import pose_errors
from mbocp.problem.problem import problem_from_tables
from mbocp.robot import Robot
from mbocp.solution import Solution
from mbocp.solving import solve

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


Solve = Callable[[Problem], Solution]

_MAX_ROBOTS = 32  # kept in a process
_robots: OrderedDict[str, Robot] = OrderedDict()
_lock = threading.Lock()  # an executor's workers may have several threads; a solve has a process for itself


@dataclass(frozen=True)
class StudyJob:
    """What all tasks of a study have in common.

    Attributes
    ----------
    document : mapping
        Tables of the problem file, with what the study fixes.
    source : Path or None
        File whose folder relative paths start from.
    label : str
        What messages call the problem.
    record : tuple of str
        Quantities that rows hold beside the usual ones.
    time_limit : float or None
        [s] for each task.
    """

    document: Mapping[str, Any]
    source: Path | None
    label: str
    record: tuple[str, ...] = ()
    time_limit: float | None = None


class _TimeIsUp(KeyboardInterrupt):
    """Ends a solve from its callback as Ctrl-C does, so that its best iterate is returned."""


class _Watch:
    """Callback of a solver that ends it when its time is up.

    The time counts from the first call, when everything is compiled and the guess is made.
    """

    def __init__(self, limit: float | None) -> None:
        self.limit = limit
        self.begun: float | None = None
        self.is_over = False

    @property
    def words(self) -> str:
        """What happened."""
        return f"stopped after time_limit = {self.limit:g} s"

    def __call__(self, _: object) -> None:
        now = time.perf_counter()
        self.begun = now if self.begun is None else self.begun
        if self.allows_less_than(now - self.begun):
            self.is_over = True
            raise _TimeIsUp

    def has_ended(self, solution: Solution) -> bool:
        """Whether it was the time limit that ended a solve, here or in a solver that looks at it itself."""
        stopped = self.limit is not None and str(solution.status) == "time_limit"
        return self.is_over or stopped or self.allows_less_than(solver_seconds(solution))

    def allows_less_than(self, seconds: float) -> bool:
        """Whether so much time is too much."""
        return self.limit is not None and seconds > self.limit


def make_problem(job: StudyJob, overrides: Mapping[str, Any]) -> Problem:
    """Problem of a task; its robot is loaded once a process."""
    document = apply_overrides(job.document, {**overrides, "solver.threads": 1})  # tasks have all processors
    if job.time_limit is not None and not _limits_time(document.get("solver")):
        document = apply_overrides(document, {"solver.time_limit": job.time_limit})
    folder = job.source.parent if job.source is not None else None
    key = json.dumps([document.get("robot"), str(folder)], sort_keys=True, default=str)
    robot = _robots.get(key)
    problem = problem_from_tables(document, robot=robot, source=job.source, label=job.label)
    _robots[key] = problem.document.robot
    _robots.move_to_end(key)
    if len(_robots) > _MAX_ROBOTS:
        _robots.popitem(last=False)
    return problem


def run_task(job: StudyJob, overrides: Mapping[str, Any], custom: Solve | None = None) -> dict[str, Any]:
    """Row of a task; whatever is raised on the way becomes one, too.

    Parameters
    ----------
    job : StudyJob
    overrides : mapping
        What makes this task, values by dotted key.
    custom : callable, optional
        Takes the place of `mbocp.solve`.
    """
    with _lock, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the parent has shown those of the first task of each kind
        clock, watch = time.perf_counter(), _Watch(job.time_limit)
        try:
            problem = make_problem(job, overrides)
            solution = custom(problem) if custom is not None else solve(problem, callback=watch)
            row = solution_row(problem, solution, time.perf_counter() - clock, job.record)
        except _TimeIsUp:
            return failure_row(TIMEOUT, watch.words, time.perf_counter() - clock)
        except CompilationTimeout as error:
            return failure_row(TIMEOUT, str(error), time.perf_counter() - clock)
        except Exception as error:
            return failure_row(ERROR, f"{type(error).__name__}: {error}", time.perf_counter() - clock)
        if not solution.converged and watch.has_ended(solution):
            row |= {"status": TIMEOUT, "message": f"{watch.words}; {row['message']}"}
        return row


def rehearse(job: StudyJob, overrides: Mapping[str, Any]) -> None:
    """Take one iteration of a task, so that all functions of its kind are compiled and in the cache."""
    with _lock, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            problem = make_problem(job, {**overrides, "solver.max_iterations": 1})
            solve(problem.with_(solver=replace(problem.solver, time_limit=None)))
        except Exception:
            return  # the task itself will say it


def _limits_time(solver: Any) -> bool:
    return isinstance(solver, Mapping) and "time_limit" in solver
