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
from typing import TypeAlias

from mbocp._tolerances import BOUND_TOLERANCE
from mbocp.accuracy import follows_fast, with_accuracy
from mbocp.exceptions import NotConverged
from mbocp.formulation import Formulation, formulate
from mbocp.guesses.around import near_the_way
from mbocp.guesses.attempts import solve_from_guesses
from mbocp.guesses.several import solve_from_starts
from mbocp.problem import Problem, load_problem
from mbocp.problem.reserves import largest_reserve, with_rows_and_room
from mbocp.solution import Solution
from mbocp.solution.reading import read_solution
from mbocp.solution.records import StartRecord
from mbocp.solvers import IterationRecord, Phase
from mbocp.solvers.reachability import dependent_end_rows
from mbocp.solvers.records import timed

__all__ = ["solve"]

Work: TypeAlias = Callable[..., Solution]  # `_solved` with what all solves of a problem share

_ROUNDS = 8  # of solving again with rows that were missing, and larger margins


def solve(
    problem: Problem | str | Path,
    *,
    solver: str | None = None,
    warm_start: Solution | None = None,
    callback: Callable[[IterationRecord], object] | None = None,
    check: bool = False,
    accuracy: bool | None = False,
    gains: bool = False,
) -> Solution:
    """Solve an optimal control problem.

    Parameters
    ----------
    problem : Problem, str or Path
        The problem, or the path of a problem file.
    solver : str, optional
        Stands for `problem.solver.method`.
    warm_start : Solution, optional
        Start from this solution, of any number of steps, instead of the problem's guess.
    callback : callable, optional
        Called with every `IterationRecord`.
    check : bool
        Raise unless converged.
    accuracy : bool, optional
        Compare the motion with what the robot would do, see `mbocp.accuracy`. None: unless that takes long to
        compile, as it does for large closed mechanisms.
    gains : bool
        Work out `Solution.gains`, the feedback of the optimum; so does `accuracy`.

    Returns
    -------
    Solution
        Converged or not: its `status` and `advice` tell. Ctrl-C ends the solve with the best iterate.

    Raises
    ------
    MbocpError
        If the problem is not well posed, or its functions cannot be compiled, or not within
        `problem.solver.time_limit`.
    NotConverged
        With `check`: carries the solution.
    """
    if not isinstance(problem, Problem):
        problem = load_problem(problem)
    if solver is not None:
        problem = problem.with_(solver=replace(problem.solver, method=solver))
    limit = problem.solver.time_limit
    deadline = math.inf if limit is None else time.perf_counter() + limit
    near = near_the_way(problem, None if warm_start is None else warm_start.qs)
    accuracy = follows_fast(problem) if accuracy is None else accuracy
    work = partial(_solved, callback=callback, deadline=deadline, with_gains=gains or accuracy)
    solution = work(near, warm_start, asked=problem)
    if not problem.goals:
        solution = _cleared(problem, near, solution, work, deadline)
    if accuracy:
        solution = with_accuracy(problem, solution, deadline)
    if check and not solution.converged:
        raise NotConverged(solution)
    return solution


def _solved(
    problem: Problem,
    warm_start: Solution | None,
    *,
    callback: Callable[[IterationRecord], object] | None,
    deadline: float,
    asked: Problem,
    with_gains: bool,
) -> Solution:
    """Solution of a problem; `asked` is what it is said to solve."""
    begun = time.perf_counter()
    phases: list[Phase] = []
    with timed(phases, "compile"):
        formulated = [
            (place if problem.goals else None, *_formulated(member, deadline))
            for place, member in problem.members
        ]
        formulation = formulated[0][1]
    starts: tuple[StartRecord, ...] = ()
    if problem.solver.starts == 1 and not problem.goals:
        outcome, guess_used = solve_from_guesses(formulation, warm_start, callback, phases, deadline)
    else:
        members = [(place, member) for place, member, _ in formulated]
        formulation, outcome, guess_used, starts = solve_from_starts(
            members, warm_start, callback, phases, deadline
        )
    left_out = next(words for _, member, words in formulated if member is formulation)
    return read_solution(
        formulation,
        outcome,
        phases,
        guess_used=guess_used,
        left_out=left_out,
        begun=begun,
        starts=starts,
        asked=asked,
        with_gains=with_gains,
    )


def _after(before: Solution, again: Solution, name: str, words: str = "") -> Solution:
    """A solution that was found from another; what both took."""
    spent = before.wall_time_s
    return replace(
        again,
        advice=again.advice + words,
        guess_used=before.guess_used,
        starts=before.starts,
        phases=(Phase(name, 0, spent), *again.phases),
        wall_time_s=spent + again.wall_time_s,
    )


def _cleared(
    problem: Problem,
    near: Problem,
    solution: Solution,
    work: Work,
    deadline: float,
) -> Solution:
    """The solution, or one with rows and room at the nodes for what it touches, there or between them."""
    solution = replace(solution, advice=solution.advice + _of_room(near))
    for _ in range(_ROUNDS):
        if not solution.is_stationary or time.perf_counter() > deadline:
            break
        is_touching = solution.clearance < -BOUND_TOLERANCE
        lacks = -solution.clearance if is_touching else 0.0
        found = with_rows_and_room(near, solution.t, solution.qs, lacks, solution.clearance_between)
        if found is None:
            break
        larger, has_more_rows = found
        again = work(larger, solution, asked=problem)
        if has_more_rows and not again.is_stationary:  # from the guess, with all that is known
            again = work(larger, None, asked=problem)
        if not has_more_rows and not (again.is_stationary and again.clearance > solution.clearance):
            break
        near, name = larger, "fewer rows" if has_more_rows else "smaller margins"
        solution = _after(solution, again, name, _of_room(near))
    return solution


def _of_room(problem: Problem) -> str:
    """What is said of room beyond the margins."""
    raised = 1e3 * largest_reserve(problem)
    return (
        f"; margins at nodes were raised by {raised:.3g} mm in all to be clear between them" if raised else ""
    )


def _formulated(problem: Problem, deadline: float) -> tuple[Formulation, str]:
    """Formulation without end conditions that the dynamics meet by themselves, and which these are."""
    formulation = formulate(problem, deadline=deadline)
    if not formulation.end_rows_may_depend or problem.goal.redundant == "keep":
        return formulation, ""
    projections = formulation.end_rows.of_joints
    found = dependent_end_rows(formulation.programme, projections)
    rows = tuple(row for row in found if row < len(projections))  # conditions of one's own stay
    if not rows:
        return formulation, ""
    names = ", ".join(formulation.programme.describe_row(-1, row) for row in rows)
    return formulate(problem, rows, deadline=deadline), f"; left out, since the dynamics imply it: {names}"
