"""One solve: its problem, what it begins with, how long it may take, and one attempt at it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

from mbocp.exceptions import InvalidValue
from mbocp.formulation import Formulation, formulate
from mbocp.guesses.attempts import solve_from_guesses
from mbocp.guesses.end_rates import with_rates_at_end
from mbocp.guesses.starts import Warm
from mbocp.problem import Problem
from mbocp.problem.reasons.causes import why_in_vain
from mbocp.programme.carried import Carried
from mbocp.solution import Solution
from mbocp.solution.reading import read_solution
from mbocp.solution.records import StartRecord
from mbocp.solution.rest import Rest, place_at
from mbocp.solvers import IterationRecord, Outcome, Phase, Status
from mbocp.solvers.reachability import dependent_end_rows
from mbocp.solvers.records import timed
from mbocp.solvers.strategies.patience import Patience

Callback: TypeAlias = Callable[[IterationRecord], object]


@dataclass(frozen=True, eq=False)
class Attempt:
    """What a solver came to, before anything is read from it.

    Attributes
    ----------
    formulation : Formulation
    outcome : Outcome
    phases : tuple of Phase
    guess_used, left_out : str
        Words for the guess, and for end conditions that were left out.
    begun : float
        Time of `time.perf_counter` at which it began.
    starts : tuple of StartRecord
        What each start came to, where there were several.
    """

    formulation: Formulation
    outcome: Outcome
    phases: tuple[Phase, ...]
    guess_used: str
    left_out: str
    begun: float
    starts: tuple[StartRecord, ...] = ()

    @property
    def is_converged(self) -> bool:
        """Whether the solver says so."""
        return self.outcome.result.status is Status.CONVERGED

    @property
    def carried(self) -> Carried:
        """Where a problem of other path constraints may begin."""
        return Carried.of(self.outcome.result.iterate, self.formulation.programme)


@dataclass(frozen=True, eq=False)
class Job:
    """A problem that is to be solved.

    Attributes
    ----------
    problem : Problem
    start : Solution or Rest, optional
        A warm start; None: the problem's guess.
    deadline : float
        Time of `time.perf_counter` after which nothing is solved again.
    patience : Patience
        Of the attempts: where it is over, nothing else is tried.
    callback : callable, optional
        Called with every record.
    has_gains : bool
        Whether the solution has the feedback of the optimum.
    accuracy : float, optional
        What asked for the steps of the problem, if they were found.
    """

    problem: Problem
    start: Solution | Rest | None
    deadline: float
    patience: Patience
    callback: Callback | None = None
    has_gains: bool = False
    accuracy: float | None = None

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
        return cls(problem, start, deadline, _patience(problem, deadline), callback, has_gains)

    def with_steps_of(self, problem: Problem, start: Solution | Rest | None) -> Job:
        """Return the job of the same problem with steps that were found; its patience begins anew."""
        patience = _patience(problem, self.deadline)
        return replace(self, problem=problem, start=start, patience=patience, accuracy=self.problem.accuracy)

    @property
    def is_late(self) -> bool:
        """Whether the time is over."""
        return time.perf_counter() > self.deadline

    def attempt(
        self,
        problem: Problem,
        start: Warm,
        rough: float = 0.0,
        *,
        is_brief: bool = False,
        callback: Callback | None = None,
    ) -> Attempt:
        """Solve once, from a start or from the guess.

        Parameters
        ----------
        problem : Problem
            That of the job, with the rows and the room that it has by now.
        start : Solution, Rest or Carried, optional
        rough : float
            Residual that will do; 0: solve to the end.
        is_brief : bool
            Whether few iterations have to do.
        callback : callable, optional
            In the place of the job's.
        """
        begun, callback = time.perf_counter(), callback or self.callback
        phases: list[Phase] = []
        with timed(phases, "compile"):
            made = [
                (place if problem.goals else None, *formulated(member, self.deadline))
                for place, member in problem.members
            ]
            formulation = made[0][1]
        once = partial(solve_from_guesses, patience=self.patience)
        starts: tuple[StartRecord, ...] = ()
        if rough or isinstance(start, Carried) or (problem.solver.starts == 1 and not problem.goals):
            outcome, guess_used = once(
                formulation, start, callback, phases, self.deadline, rough, is_brief=is_brief
            )
        else:
            from mbocp.guesses.several import solve_from_starts

            members = [(place, member) for place, member, _ in made]
            formulation, outcome, guess_used, starts = solve_from_starts(
                members, start, callback, phases, self.deadline
            )
        left_out = next(words for _, member, words in made if member is formulation)
        if not rough:
            formulation, outcome = with_rates_at_end(
                formulation,
                outcome,
                lambda moved, start: once(moved, start, callback, phases, self.deadline)[0],
            )
        return Attempt(formulation, outcome, tuple(phases), guess_used, left_out, begun, starts)

    def read(self, attempt: Attempt) -> Solution:
        """Return the solution of what was asked for, from what a solver came to."""
        asked = self.problem if self.accuracy is None else self.problem.with_(accuracy=self.accuracy)
        return read_solution(
            attempt.formulation,
            attempt.outcome,
            list(attempt.phases),
            guess_used=attempt.guess_used,
            left_out=attempt.left_out,
            begun=attempt.begun,
            starts=attempt.starts,
            asked=asked,
            with_gains=self.has_gains,
        )


def _patience(problem: Problem, deadline: float) -> Patience:
    return Patience(is_limited=math.isinf(deadline), why_in_vain=partial(why_in_vain, problem))


def _deadline(*limits: float | None) -> float:
    """When the first of the limits [s] is over, by `time.perf_counter`."""
    given = [limit for limit in limits if limit is not None]
    for limit in given:
        if not limit > 0.0:
            raise InvalidValue("time_limit", limit, "a positive number of seconds")
    return time.perf_counter() + min(given, default=math.inf)


def _start_of(warm_start: Solution | None, at: float | None) -> Solution | Rest | None:
    if at is None:
        return warm_start
    if warm_start is None:
        raise InvalidValue("at", at, "None without a warm start")
    place_at(warm_start, at)
    return Rest(warm_start, at)


def formulated(problem: Problem, deadline: float) -> tuple[Formulation, str]:
    """Formulation without end conditions that the dynamics meet by themselves, and words for these."""
    formulation = formulate(problem, deadline=deadline)
    if not formulation.end_rows_may_depend or problem.goal.redundant == "keep":
        return formulation, ""
    projections = formulation.end_rows.of_joints
    found = dependent_end_rows(formulation.programme, projections)
    rows = tuple(row for row in found if row < len(projections))  # conditions of one's own stay
    if not rows:
        return formulation, ""
    from mbocp.formulation.fewer_ends import without_end_rows

    names = ", ".join(formulation.programme.describe_row(-1, row) for row in rows)
    fewer = without_end_rows(formulation, rows, deadline=deadline)
    return fewer, f"; left out, since the dynamics imply it: {names}"
