"""Solving around obstacles: rows for what a motion comes near, and room for what it does between nodes.

Which pairs of things need rows, and how much room the nodes have to leave, is known from a motion alone. So
the problem is solved roughly first, until no row is missing, and then to the end. What touches something all
the same is solved again from where it is. Other ways, where one comes to nothing, are tried side by side.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from mbocp._threads import SideBySide, Watch
from mbocp._tolerances import BOUND_TOLERANCE
from mbocp.guesses.around import around, has_no_way, near_the_way
from mbocp.job import Attempt, Job
from mbocp.problem import Guess, Problem, SolverOptions
from mbocp.problem.obstacles.near_pairs import missing_pairs, rows_of, with_pairs
from mbocp.problem.obstacles.reserves import (
    largest_reserve,
    with_first_reserve,
    with_room,
    with_rows_and_room,
)
from mbocp.solution import Solution
from mbocp.solution.later import is_there, retold
from mbocp.solution.rest import Rest
from mbocp.solvers import Phase, Status
from mbocp.solvers.strategies.patience import Patience

_ROUNDS = 8  # of solving again with rows that were missing, and larger margins
_ROUGH = 2e-2  # residual of a motion that shows what it comes near
_DEEP = 0.01  # [m]: what is so deep in something does not come out of it by itself
_OTHER_WAYS, _CORNERS = 3, 60  # tried where one comes to nothing; configurations that say one
_NO_WAY = "a search has found no way around the obstacles: there may be none"
_STOPPED = (Status.INTERRUPTED, Status.TIME_LIMIT)
_WITH_WAYS = ("auto", "way")  # guesses beside which there are others
_METHODS = ("auto", "monolithic")  # those that can end there


def solve_clear(job: Job) -> Solution:
    """Solve a problem, so that the motion touches nothing, if that can be had.

    Where a warm start leads to no solution soon, the problem's own guess comes next.
    """
    solution = _solve_in_turn(job)
    if solution.is_stationary or not job.patience.words:
        return solution
    status = job.patience.status_of(solution.status)
    return retold(solution, status=status, advice=f"{solution.advice}; {job.patience.words}")


def _solve_in_turn(job: Job) -> Solution:
    """From the warm start, briefly; from the problem's guess; from the warm start, at length."""
    if job.start is None:
        return _from_guess(job)
    if not _has_a_guess_left(job.problem):
        return _solved(job, job.problem, job.start)
    solution = _solved(job, job.problem, job.start, is_brief=True)
    if _is_final(solution, job.patience):
        return solution
    again = _from_guess(job)
    if not _is_final(again, job.patience):
        again = _later(again, _solved(job, job.problem, job.start), "from the guess")
    return _later(solution, again, "from the warm start")


def _is_final(solution: Solution, patience: Patience) -> bool:
    """Whether nothing else is to be tried after a solution."""
    return solution.is_stationary or solution.status in _STOPPED or patience.is_over


def _has_a_guess_left(problem: Problem) -> bool:
    """Whether a problem may be solved from its own guess, too, after a warm start."""
    solver = problem.solver
    return solver.starts == 1 and not problem.goals and solver.max_iterations is None


def _later(first: Solution, second: Solution, name: str) -> Solution:
    """The better of two solutions, with what both took and how the first ended."""
    is_first = not second.is_stationary and first.residual < second.residual
    better, other = (first, second) if is_first else (second, first)
    taken, spent = other.iterations, other.wall_time_s
    words = f"; {name}: {first.status} after {first.iterations} iterations"
    return retold(
        better,
        advice=better.advice + ("" if is_first else words),
        iterations=better.iterations + taken,
        phases=(Phase(name, taken, spent), *better.phases),
        history=(*first.history, *second.history),
        wall_time_s=better.wall_time_s + spent,
    )


def _from_guess(job: Job) -> Solution:
    """Solution from the problem's own guess; if that leads to none, from other ways around obstacles."""
    solution = _solved(job, job.problem, None)
    if solution.converged or solution.status in _STOPPED or job.patience.is_over:
        return solution
    if has_no_way(job.problem):
        return retold(solution, advice=f"{solution.advice}; {_NO_WAY}")
    return _by_other_ways(job, solution) if _may_be_on_the_wrong_side(job.problem) else solution


def _by_other_ways(job: Job, known: Solution) -> Solution:
    """Solution on the first other way that leads to one, or the known one; ways side by side."""
    problem = job.problem
    has_ours = problem.guess.kind == "way" and around(problem) is not None  # None: the line is clear
    seeds = range(0 if has_ours else 1, 1 + _OTHER_WAYS)

    def work(place: int, watch: Watch) -> Solution | None:
        other = _on_way(problem, seeds[place], replace(problem.solver, threads=threads // len(seeds) or 1))
        if other is None or job.is_late or job.patience.is_over:
            return None
        return _solved(replace(job, callback=watch), other, None)

    def ends(found: Solution | None) -> bool:
        return found is None or found.converged or found.status in _STOPPED

    begun, threads = time.perf_counter(), problem.solver.num_threads
    row = SideBySide(work, len(seeds), job.callback, ends=ends, is_interrupted=_is_interrupted)
    tried = [found for found in row.run(threads).values() if found is not None]
    spent = time.perf_counter() - begun
    for number, again in enumerate(tried, start=2):
        if again.converged:
            before = retold(known, wall_time_s=known.wall_time_s + spent - again.wall_time_s)
            words = f"way {number} around obstacles, inverse dynamics"
            return _found_from(before, again, "other ways", guess_used=words)
    return retold(known, wall_time_s=known.wall_time_s + spent)


def _is_interrupted(found: Solution | None) -> bool:
    return found is not None and found.status is Status.INTERRUPTED


def _may_be_on_the_wrong_side(problem: Problem) -> bool:
    """Whether a solve that has come to nothing may come to something on another way."""
    has_ways = problem.clearance is not None and not problem.goals and problem.guess.kind in _WITH_WAYS
    return has_ways and problem.solver.starts == 1 and problem.solver.max_iterations is None


def _on_way(problem: Problem, seed: int, solver: SolverOptions) -> Problem | None:
    """The problem with a guess that these random numbers lead to; None where there is none."""
    way = around(problem, seed)
    if way is None:
        return None
    corners = way(problem.q_start, np.linspace(0.0, 1.0, _CORNERS))[1:-1]
    return replace(problem, guess=Guess(kind="way", q=corners), solver=solver)


def _solved(job: Job, problem: Problem, start: Solution | Rest | None, *, is_brief: bool = False) -> Solution:
    """Solution from one guess, with the rows and the room that it asks for."""
    attempt = partial(job.attempt, is_brief=is_brief)
    near = _near(problem, start)
    before: list[Attempt] = []
    if start is None and near.solver.starts == 1 and _may_be_rough(near):
        near = _roughly(job, near, before)
    begin = before[-1].carried if before and before[-1].is_converged else start
    found = attempt(near, begin)
    if before and begin is not None and not (found.is_converged or job.patience.is_over):
        before.append(found)
        found = attempt(near, None)
    solution = _after(before, job.read(found))
    return solution if problem.goals else _cleared(job, near, solution, found, attempt)


def _near(problem: Problem, warm_start: Solution | Rest | None) -> Problem:
    """The problem with the rows and the room of a warm start, or with rows for what comes near its way."""
    if warm_start is None:
        return near_the_way(problem)
    carried, clearance = warm_start.iterate, problem.clearance
    is_known = carried is not None and clearance is not None and carried.room.size == clearance.num_pairs
    if carried is None or not is_known or problem.goals:
        return near_the_way(problem, warm_start.qs)
    return with_room(problem, carried.room, warm_start.qs)


def _may_be_rough(near: Problem) -> bool:
    """Whether rows have been chosen, and the solver may end early."""
    rows, solver = rows_of(near), near.solver
    is_left_to_us = solver.method in _METHODS and solver.globalisation == "default"
    return rows is not None and rows.chosen is not None and is_left_to_us and solver.max_iterations is None


def _roughly(job: Job, near: Problem, before: list[Attempt]) -> Problem:
    """The problem with the rows that rough solutions ask for; these are added to `before`.

    Each begins at the guess: what is deep in something has come there on a way that is no good any more.
    """
    for _ in range(_ROUNDS):
        before.append(job.attempt(near, None, _ROUGH))
        if not before[-1].is_converged or job.is_late:
            break
        motion = before[-1].formulation.motion_of(before[-1].outcome.result.iterate)
        missing = missing_pairs(near, motion.qs)
        rows = rows_of(near)
        if not missing or rows is None or rows.chosen is None:
            return with_first_reserve(near, motion.qs)
        near = with_pairs(near, {*rows.chosen, *missing})
    return near


def _after(before: list[Attempt], solution: Solution) -> Solution:
    """A solution that counts what came before."""
    if not before:
        return solution
    taken = sum(attempt.outcome.iterations for attempt in before)
    spent = sum(phase.wall_time_s for attempt in before for phase in attempt.phases)
    return retold(
        solution,
        guess_used=before[0].guess_used,
        iterations=taken + solution.iterations,
        phases=(Phase("rows and room", taken, spent), *solution.phases),
        wall_time_s=spent + solution.wall_time_s,
    )


def _cleared(
    job: Job, near: Problem, solution: Solution, found: Attempt, attempt: Callable[..., Attempt]
) -> Solution:
    """The solution, or one with rows and room at the nodes for what it touches, there or between them."""
    solution = retold(solution, advice=solution.advice + _of_room(near))
    for _ in range(_ROUNDS):
        if not solution.is_stationary or job.is_late:
            break
        lacks, touching = 0.0, ""
        if is_there(solution, "clearance"):  # else nothing is nearer than it may be
            lacks = -solution.clearance if solution.clearance < -BOUND_TOLERANCE else 0.0
            touching = solution.clearance_between
        wider = with_rows_and_room(near, solution.t, solution.qs, lacks, touching)
        if wider is None:
            break
        larger, has_more_rows = wider
        is_deep = has_more_rows and lacks > _DEEP
        tried = attempt(larger, None if is_deep else found.carried)
        again = job.read(tried)
        is_lost = has_more_rows and not again.is_stationary
        if is_lost and not is_deep:  # from the guess, with all that is known
            tried = attempt(larger, None)
            again = job.read(tried)
        if not has_more_rows and not (again.is_stationary and again.clearance > solution.clearance):
            break
        near, found, name = larger, tried, "fewer rows" if has_more_rows else "smaller margins"
        solution = _found_from(solution, again, name, _of_room(near))
    return solution


def _found_from(
    before: Solution, again: Solution, name: str, words: str = "", guess_used: str | None = None
) -> Solution:
    """A solution that was found after another; what both took."""
    spent = before.wall_time_s
    return retold(
        again,
        advice=again.advice + words,
        guess_used=before.guess_used if guess_used is None else guess_used,
        starts=before.starts,
        phases=(Phase(name, 0, spent), *again.phases),
        wall_time_s=spent + again.wall_time_s,
    )


def _of_room(problem: Problem) -> str:
    """What is said of room beyond the margins."""
    raised = 1e3 * largest_reserve(problem)
    return (
        f"; margins at nodes were raised by {raised:.3g} mm in all to be clear between them" if raised else ""
    )
