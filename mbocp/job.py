"""One solve: its problem, what it begins with, how long it may take, and what solvers come to."""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np

from mbocp._arrays import dataclass
from mbocp.exceptions import InvalidValue, ProblemFileError
from mbocp.formulation import Formulation
from mbocp.formulation.iterates import take_end_of
from mbocp.problem import Problem
from mbocp.problem.file.goal_table import write_goal
from mbocp.programme.iterate import IterateRecord
from mbocp.solution import Solution
from mbocp.solution.read_solution import Attempt, read_solution
from mbocp.solution.rest import Rest, place_at
from mbocp.solvers import SolverSettings, Status
from mbocp.solvers.records import Callback
from mbocp.solvers.strategies.patience import MORE_TIME, Patience

if TYPE_CHECKING:
    from mbocp.problem.reasons.cause import Cause

_SAME = 1e-9  # [rad, m]
_EXPLAIN = "`mbocp explain FILE` looks for the limit that excludes it"

Warm: TypeAlias = Solution | Rest | IterateRecord | None  # where to start; None: from the guess


@dataclass(frozen=True, eq=False)
class Job:
    """A problem that is to be solved.

    Attributes
    ----------
    asked : Problem
        What was asked for; the solution is said to be of it.
    problem : Problem
        The same with the steps, the rows and the room that it has by now.
    start : Solution, Rest or IterateRecord, optional
        A warm start; None: the problem's guess.
    deadline : float
        Time of `time.perf_counter` after which nothing is solved again.
    patience : Patience
        Of the attempts: where it is over, nothing else is tried.
    callback : callable, optional
        Called with every record.
    has_gains : bool
        Whether the solution has the feedback of the optimum.
    rough : float
        Residual that will do; 0: solve to the end.
    brief : int
        Iterations of the monolithic solver that have to do; 0: as the problem's solver asks.
    is_only : bool
        Whether nothing else is tried: no other guess, no other way, no other minimum.
    found : list of Solution, optional
        All solutions that have been read are added to it.
    """

    asked: Problem
    problem: Problem
    start: Warm
    deadline: float
    patience: Patience
    callback: Callback | None = None
    has_gains: bool = False
    rough: float = 0.0
    brief: int = 0
    is_only: bool = False
    found: list[Solution] | None = None

    @classmethod
    def of(
        cls,
        problem: Problem,
        warm_start: Solution | None = None,
        at: float | None = None,
        *,
        time_limit: float | None = None,
        callback: Callback | None = None,
        has_gains: bool = False,
    ) -> Job:
        """Make a job of the arguments of `mbocp.solve`; its time begins now.

        Raises
        ------
        InvalidValue
            If `time_limit` is not positive, or `at` is no time of the motion of `warm_start`.
        """
        start, deadline = _start_of(warm_start, at), _deadline(problem.solver.time_limit, time_limit)
        has_gains = has_gains or problem.accuracy is not None
        near = _with_end_of(problem, start) if isinstance(start, Solution) else problem
        return cls(problem, near, start, deadline, _patience(problem, deadline), callback, has_gains)

    def with_steps_of(self, problem: Problem, start: Warm) -> Job:
        """Return the job of the same problem with steps that were found; its patience begins anew."""
        asked = problem.with_(accuracy=self.problem.accuracy)
        return replace(self, asked=asked, problem=problem, start=start).anew()

    def anew(self) -> Job:
        """Return the job with all its patience."""
        return replace(self, patience=_patience(self.problem, self.deadline))

    def with_limits_within(self, letters: str) -> Job:
        """Return the job with limits that hold within steps, by their letters."""
        if letters == self.problem.limits_within:
            return self
        return replace(self, problem=replace(self.problem, limits_within=letters))

    @property
    def is_late(self) -> bool:
        """Whether the time is over."""
        return time.perf_counter() > self.deadline

    @property
    def has_several_starts(self) -> bool:
        """Whether several guesses or goals are to be tried, and no more is known."""
        is_free = not (self.rough or self.is_only or isinstance(self.start, IterateRecord))
        return is_free and (self.problem.solver.num_starts > 1 or bool(self.problem.goals))

    def read(self, attempt: Attempt) -> Solution:
        """Return the solution of what was asked for, from what a solver came to."""
        solution = read_solution(attempt, self.asked, with_gains=self.has_gains)
        if self.found is not None:
            self.found.append(solution)
        return solution


class Strategy(Protocol):
    """A way to do a job: frozen, with one method."""

    def run(self, job: Job) -> Solution:
        """Do the job."""


def settings_of(formulation: Formulation, threads: int | None = None) -> SolverSettings:
    """Settings of the solver that a problem asks for; with other `threads`, if given."""
    problem, options = formulation.problem, formulation.problem.solver
    threads = options.num_threads if threads is None else threads
    is_bounded = problem.is_bounded
    return SolverSettings.of(options, formulation.programme, has_inequalities=is_bounded, threads=threads)


def _patience(problem: Problem, deadline: float) -> Patience:
    def why_in_vain(status: Status) -> Cause | None:
        from mbocp.problem.reasons import causes  # many modules, and few solves are in vain

        return causes.why_in_vain(problem, status)

    remedy = f"{_EXPLAIN}; else {MORE_TIME}" if problem.is_bounded else MORE_TIME
    return Patience(is_limited=math.isinf(deadline), why_in_vain=why_in_vain, remedy=remedy)


def _deadline(*limits: float | None) -> float:
    """When the first of the limits [s] is over, by `time.perf_counter`."""
    given = [limit for limit in limits if limit is not None]
    for limit in given:
        if not limit > 0.0:
            raise InvalidValue("time_limit", limit, "a positive number of seconds")
    return time.perf_counter() + min(given, default=math.inf)


def _with_end_of(problem: Problem, before: Solution) -> Problem:
    """The problem with the end that a solution of it has found, where it is asked for the same ends."""
    carried = before.iterate
    if carried is None or not carried.q_end.size or len(problem.parameter) != carried.first.size:
        return problem
    try:
        known = before.problem
    except ProblemFileError:  # of a file whose terms are Python
        return problem
    starts = (before.qs[0], carried.q_start) if problem.parameter else (problem.q_start,)
    is_same = [one.name for one in problem.parameter] == [one.name for one in known.parameter]
    is_same &= problem.robot.shape_fingerprint == known.robot.shape_fingerprint
    is_same &= any(np.allclose(problem.q_start, q, rtol=0.0, atol=_SAME) for q in starts)
    is_same &= _write(write_goal(problem)) == _write(write_goal(known))
    return take_end_of(problem, carried) if is_same else problem


def _write(table: dict[str, Any]) -> str:
    return json.dumps(table, default=np.ndarray.tolist)


def _start_of(warm_start: Solution | None, at: float | None) -> Solution | Rest | None:
    if at is None:
        return warm_start
    if warm_start is None:
        raise InvalidValue("at", at, "None without a warm start")
    place_at(warm_start, at)
    return Rest(warm_start, at)
