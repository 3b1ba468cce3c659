"""The top-level `solve`: load -> formulate -> guess -> solve -> read back, each phase timed.

The module is not called `solve`: importing it would put it into the place of the function `mbocp.solve`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from mbocp.accuracy.of_solution import follows_fast, with_accuracy
from mbocp.clearing import Attempt, solve_clear
from mbocp.exceptions import InvalidValue, NotConverged
from mbocp.formulation import Formulation, formulate
from mbocp.guesses.attempts import solve_from_guesses
from mbocp.guesses.end_rates import with_rates_at_end
from mbocp.guesses.starts import Warm
from mbocp.problem import Problem
from mbocp.problem.reasons.causes import why_in_vain
from mbocp.programme.carried import Carried
from mbocp.solution import Solution
from mbocp.solution.from_files import problem_from
from mbocp.solution.later import retold
from mbocp.solution.reading import read_solution
from mbocp.solution.records import StartRecord
from mbocp.solution.rest import Rest, place_at
from mbocp.solvers import IterationRecord, Phase
from mbocp.solvers.reachability import dependent_end_rows
from mbocp.solvers.records import timed
from mbocp.solvers.strategies.patience import Patience

__all__ = ["formulated", "solve"]


def solve(
    problem: Problem | str | Path,
    *,
    solver: str | None = None,
    warm_start: Solution | None = None,
    at: float | None = None,
    callback: Callable[[IterationRecord], object] | None = None,
    check: bool = False,
    accuracy: bool | None = False,
    gains: bool = False,
    time_limit: float | None = None,
) -> Solution:
    """Solve an optimal control problem.

    Parameters
    ----------
    problem : Problem, str or Path
        The problem, or the path of a problem file, or of a result, whose problem is solved again.
    solver : str, optional
        Stands for `problem.solver.method`.
    warm_start : Solution, optional
        Start from this solution, of any number of steps, instead of the problem's guess. Where the problem
        begins later on its motion, from the rest of that. Where it leads to no solution soon, the problem's
        guess is tried, too.
    at : float, optional
        Time [s] on the motion of `warm_start` at which the problem begins. None: it is found.
    callback : callable, optional
        Called with every `IterationRecord`.
    check : bool
        Raise unless converged.
    accuracy : bool, optional
        Compare the motion with what the robot would do, see `mbocp.accuracy`. None: unless that takes long to
        compile, as it does for large closed mechanisms.
    gains : bool
        Work out `Solution.gains`, the feedback of the optimum; so does `accuracy`.
    time_limit : float, optional
        Longest time of this solve [s], beside that of the problem; the result does not record it.

    Returns
    -------
    Solution
        Converged or not: its `status` and `advice` tell. Ctrl-C ends the solve with the best iterate.

    Raises
    ------
    MbocpError
        If the problem is not well posed, or its functions cannot be compiled, or not within
        `problem.solver.time_limit` or `time_limit`.
    InvalidValue
        If `time_limit` is not positive, or `at` is no time of the motion of `warm_start`.
    NotConverged
        With `check`: carries the solution.
    """
    problem = problem_from(problem)
    if solver is not None:
        problem = problem.with_(solver=replace(problem.solver, method=solver))
    deadline = _deadline(problem.solver.time_limit, time_limit)
    accuracy = follows_fast(problem) if accuracy is None else accuracy
    attempt = partial(_attempted, deadline=deadline, callback=callback)
    has_gains = gains or accuracy or problem.accuracy is not None
    work = partial(
        _worked,
        attempt=attempt,
        read=partial(_read, with_gains=has_gains),
        deadline=deadline,
        callback=callback,
    )
    start = _start_of(warm_start, at)
    if problem.accuracy is not None:
        from mbocp.accuracy.refining import refined

        solution = refined(problem, start, partial(work, accuracy=problem.accuracy), deadline)
    else:
        solution = work(problem, start)
    if accuracy and problem.accuracy is None:
        solution = with_accuracy(problem, solution, deadline)
    if check and not solution.converged:
        raise NotConverged(solution)
    return solution


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


def _worked(
    problem: Problem,
    warm_start: Solution | Rest | None,
    *,
    accuracy: float | None = None,
    attempt: Callable[..., Attempt],
    read: Callable[..., Solution],
    deadline: float,
    callback: Callable[[IterationRecord], object] | None,
) -> Solution:
    """Solve with the steps of a problem; where an accuracy asked for them, the result says so."""
    asked = problem if accuracy is None else problem.with_(accuracy=accuracy)
    own = partial(read, asked=asked)
    patience = Patience(is_limited=math.isinf(deadline), why_in_vain=partial(why_in_vain, problem))
    patient = partial(attempt, patience=patience)
    solution = solve_clear(problem, warm_start, patient, own, deadline, patience, callback)
    if solution.is_stationary or not patience.words:
        return solution
    return retold(solution, advice=f"{solution.advice}; {patience.words}")


def _attempted(
    problem: Problem,
    start: Warm,
    rough: float = 0.0,
    *,
    is_brief: bool = False,
    callback: Callable[[IterationRecord], object] | None,
    deadline: float,
    patience: Patience,
) -> Attempt:
    """What a solver comes to."""
    begun = time.perf_counter()
    phases: list[Phase] = []
    with timed(phases, "compile"):
        made = [
            (place if problem.goals else None, *formulated(member, deadline))
            for place, member in problem.members
        ]
        formulation = made[0][1]
    starts: tuple[StartRecord, ...] = ()
    if rough or isinstance(start, Carried) or (problem.solver.starts == 1 and not problem.goals):
        outcome, guess_used = solve_from_guesses(
            formulation, start, callback, phases, deadline, rough, is_brief=is_brief, patience=patience
        )
    else:
        from mbocp.guesses.several import solve_from_starts

        members = [(place, member) for place, member, _ in made]
        formulation, outcome, guess_used, starts = solve_from_starts(
            members, start, callback, phases, deadline
        )
    left_out = next(words for _, member, words in made if member is formulation)
    if not rough:
        formulation, outcome = with_rates_at_end(
            formulation,
            outcome,
            lambda moved, start: solve_from_guesses(
                moved, start, callback, phases, deadline, patience=patience
            )[0],
        )
    return Attempt(formulation, outcome, tuple(phases), guess_used, left_out, begun, starts)


def _read(attempt: Attempt, *, asked: Problem, with_gains: bool) -> Solution:
    """Solution of what was asked for from what a solver came to."""
    return read_solution(
        attempt.formulation,
        attempt.outcome,
        list(attempt.phases),
        guess_used=attempt.guess_used,
        left_out=attempt.left_out,
        begun=attempt.begun,
        starts=attempt.starts,
        asked=asked,
        with_gains=with_gains,
    )


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
