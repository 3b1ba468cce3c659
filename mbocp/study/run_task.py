"""One task, in the process that solves it: make the problem, solve it, return a row."""

from __future__ import annotations

import json
import threading
import time
import warnings
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from mbocp._arrays import dataclass
from mbocp.exceptions import CompilationTimeout
from mbocp.problem import Problem
from mbocp.problem.file.overrides import apply_overrides
from mbocp.problem.problem import problem_from_tables
from mbocp.robot import Robot
from mbocp.solution import Solution
from mbocp.solving import solve
from mbocp.study.result_rows import ERROR, TIMEOUT, failure_row, solution_row, solver_seconds

Solve = Callable[[Problem], Solution]

_MAX_ROBOTS = 32  # kept in a process
_robots: OrderedDict[str, Robot] = OrderedDict()
_lock = threading.Lock()  # an executor's workers may have several threads; a solve has a process for itself


@dataclass(frozen=True)
class Job:
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


def make_problem(job: Job, overrides: Mapping[str, Any]) -> Problem:
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


def run_task(job: Job, overrides: Mapping[str, Any], custom: Solve | None = None) -> dict[str, Any]:
    """Row of a task; whatever is raised on the way becomes one, too.

    Parameters
    ----------
    job : Job
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


def rehearse(job: Job, overrides: Mapping[str, Any]) -> None:
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
