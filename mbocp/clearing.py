"""Solving around obstacles: rows for what a motion comes near, and room for what it does between nodes.

Which pairs of things need rows, and how much room the nodes have to leave, is known from a motion alone. So
the problem is solved roughly first, until no row is missing, and then to the end. What touches something all
the same is solved again from where it is. Other ways, where one comes to nothing, are tried side by side.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from copy import copy
from dataclasses import field, replace

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp._threads import SideBySide, Watch
from mbocp._tolerances import BOUND_TOLERANCE
from mbocp.exceptions import CompilationTimeout
from mbocp.formulation.read_trajectory import times_of
from mbocp.guesses.around import around, has_no_way, may_have_ways, near_the_way
from mbocp.guesses.in_turn import attempt
from mbocp.job import Job, Strategy, Warm
from mbocp.problem import Guess, Problem, SolverOptions
from mbocp.problem.between_nodes import GROSS_EXCESS
from mbocp.problem.obstacles.approach import Approach, touches_along
from mbocp.problem.obstacles.reserves import (
    largest_reserve,
    rows_of,
    with_first_reserve,
    with_room,
    with_rows_and_room,
)
from mbocp.programme.iterate import IterateRecord
from mbocp.solution import Solution
from mbocp.solution.later import is_there, retold
from mbocp.solution.read_solution import Attempt
from mbocp.solution.rest import Rest
from mbocp.solvers import Phase, Status

_ROUNDS = 8  # of solving again with rows that were missing, and larger margins
_ROUGH = 2e-2  # residual of a motion that shows what it comes near
_IN_VAIN = 3  # of these in which a motion comes no nearer to touching nothing
_DEEP = 0.01  # [m]: what is so deep in something does not come out of it by itself
_BRIEF = 200  # iterations on one way before others; most take a quarter, and IPOPT as long as several ways
_IN_ALL = 300  # iterations of all rounds on one way before others; most take less than 260
_OTHER_WAYS, _CORNERS = 3, 60  # tried where one comes to nothing; configurations that say one
_NO_WAY = "a search has found no way around the obstacles: there may be none"
_WITH_WAYS = ("auto", "way")  # guesses beside which there are others
_METHODS = ("auto", "monolithic")  # those that can end there


@dataclass(frozen=True)
class ClearOfObstacles:
    """Solve from one guess, so that the motion touches nothing, if that can be had."""

    def run(self, job: Job) -> Solution:
        """Solve with the rows and the room that the motion asks for."""
        near, before = _near(job), list[Attempt]()
        try:
            near, found = self._solve(job, near, before)
        except CompilationTimeout as end:
            if not before:
                raise
            found = _out_of_time(before.pop(), end)
        solution = _tell_room(_count(before, job.read(found)), near.problem)
        return _ClearanceRounds(job, near.problem, found, solution).run()

    def _solve(self, job: Job, near: Job, before: list[Attempt]) -> tuple[Job, Attempt]:
        """Solve with all rows that it takes; attempts before the last one are added to `before`."""
        if job.start is None and job.problem.solver.num_starts == 1 and _may_be_rough(near.problem):
            near = _find_rows(near, before)
        if before and job.brief and not before[-1].is_converged:
            return near, before.pop()  # the same steps again would lead to the same end
        if before and before[-1].is_converged:
            near = replace(near, start=before[-1].carried)
        found = attempt(near)
        is_over = found.is_converged or job.patience.is_over
        if before and near.start is not None and not is_over:
            before.append(found)
            found = attempt(replace(near, start=None))
        return near, found


@dataclass(frozen=True)
class OtherWays:
    """Solve; where that comes to nothing, try other ways around obstacles, side by side.

    Attributes
    ----------
    once : Strategy
        For each way.
    """

    once: Strategy

    def run(self, job: Job) -> Solution:
        """Solve briefly on the problem's own way and on others, then at length, until there is a solution."""
        may_have_others = not job.is_only and _may_be_on_the_wrong_side(job.problem)
        is_brief = may_have_others and not job.brief and may_have_ways(job.problem)
        solution = self.once.run(replace(job, brief=_BRIEF) if is_brief else job)
        if _is_final(solution, job):
            return solution
        if has_no_way(job.problem):
            return retold(solution, advice=f"{solution.advice}; {_NO_WAY}")
        if may_have_others:
            solution = self._try_others(replace(job, brief=_BRIEF) if is_brief else job, solution)
        if not is_brief or solution.is_stationary or solution.status.is_stopped or job.is_late:
            return solution
        return after(solution, self.once.run(job.anew()), "other ways")

    def _try_others(self, job: Job, known: Solution) -> Solution:
        """Return the solution on the first other way that leads to one, or the known one."""
        problem = job.problem
        begun, threads = time.perf_counter(), problem.solver.num_threads
        has_ours = problem.guess.kind == "way" and around(problem) is not None  # None: the line is clear
        seeds = range(0 if has_ours else 1, 1 + _OTHER_WAYS)
        solver = replace(problem.solver, threads=threads // len(seeds) or 1)

        def work(place: int, watch: Watch) -> Solution | None:
            other = _on_way(problem, seeds[place], solver)
            if other is None or job.is_late:
                return None
            # What is left is for each of them, whatever others have taken of it by then.
            return self.once.run(replace(job, problem=other, callback=watch, patience=copy(job.patience)))

        row = SideBySide(work, len(seeds), job.callback, ends=_ends_search, is_interrupted=_is_interrupted)
        tried = [found for found in row.run(threads).values() if found is not None]
        spent = time.perf_counter() - begun
        for number, again in enumerate(tried, start=2):
            if again.converged:
                before = retold(known, wall_time_s=known.wall_time_s + spent - again.wall_time_s)
                words = f"way {number} around obstacles, inverse dynamics"
                return retold(after(before, again, "other ways"), guess_used=words)
        return retold(known, wall_time_s=known.wall_time_s + spent)


def _is_final(solution: Solution, job: Job) -> bool:
    """Whether nothing else helps: what touches nothing, and does not leap past it, has no fault of a way."""
    is_clear = solution.is_stationary and not (depth_of(solution) or _leaps(solution))
    return is_clear or solution.status.is_stopped or job.is_only or job.patience.is_over


def _leaps(solution: Solution) -> bool:
    """Whether a step is no motion any more, as where it leaps past what is between its nodes."""
    return solution.status is Status.UNDER_RESOLVED and not solution.limit_excess > GROSS_EXCESS


def depth_of(solution: Solution) -> float:
    """How deep a solution is in something [m]; 0: in nothing."""
    if not is_there(solution, "clearance"):  # then nothing is nearer than it may be
        return 0.0
    return -solution.clearance if solution.clearance < -BOUND_TOLERANCE else 0.0


def _ends_search(found: Solution | None) -> bool:
    """Whether no way after this one is asked for."""
    return found is None or found.converged or found.status.is_stopped


def _is_interrupted(found: Solution | None) -> bool:
    return found is not None and found.status is Status.INTERRUPTED


def _may_be_on_the_wrong_side(problem: Problem) -> bool:
    """Whether a solve that has come to nothing may come to something on another way."""
    solver = problem.solver
    return problem.guess.kind in _WITH_WAYS and solver.num_starts == 1 and solver.max_iterations is None


def _on_way(problem: Problem, seed: int, solver: SolverOptions) -> Problem | None:
    """The problem with a guess that these random numbers lead to; None where there is none."""
    clearance = problem.clearance
    way = None if clearance is None or clearance.movers else around(problem, seed)
    if way is None:  # configurations alone do not say a way by the time
        return None
    corners = way(problem.q_start, np.linspace(0.0, 1.0, _CORNERS))[1:-1]
    return replace(problem, guess=Guess(kind="way", q=corners), solver=solver)


def _near(job: Job) -> Job:
    """The job with the rows and the room of its warm start, or with rows for what comes near its way."""
    problem, start = job.problem, job.start
    if start is None or isinstance(start, IterateRecord):
        return replace(job, problem=near_the_way(problem))
    carried, clearance = start.iterate, problem.clearance
    is_known = carried is not None and clearance is not None and carried.room.size == clearance.num_pairs
    if carried is None or not is_known:
        return replace(job, problem=near_the_way(problem, _times(start), start.qs))
    return replace(job, problem=with_room(problem, carried.room, _times(start), start.qs))


def _times(start: Solution | Rest) -> Array:
    """Times of the motion that a warm start says, from where it begins [s]."""
    return start.t if isinstance(start, Solution) else start.solution.t - start.at


def _may_be_rough(near: Problem) -> bool:
    """Whether rows have been chosen, and the solver may end early."""
    rows, solver = rows_of(near), near.solver
    is_left_to_us = solver.method in _METHODS and solver.globalisation == "default"
    return rows is not None and rows.chosen is not None and is_left_to_us and solver.max_iterations is None


def _find_rows(near: Job, before: list[Attempt]) -> Job:
    """The job with the rows and the room that rough solutions ask for; these are added to `before`.

    What is deep in something has come there on a way that is no good any more, and begins at the guess again.
    """
    for _ in range(_ROUNDS):
        before.append(attempt(replace(near, rough=_ROUGH, brief=near.brief or _BRIEF)))
        if near.is_late or not (before[-1].is_converged or near.start is not None):
            break
        if not before[-1].is_converged:
            near = replace(near, start=None)
            continue
        motion = before[-1].formulation.motion_of(before[-1].outcome.result.iterate)
        t = times_of(near.problem, motion.dts)
        touches = _touches(near.problem, t, motion.qs, motion.vs)
        wider = with_rows_and_room(near.problem, t, motion.qs, motion.vs, touches)
        if wider is None:
            return replace(near, problem=with_first_reserve(near.problem, t, motion.qs))
        larger, has_more_rows = wider
        is_deep = min((touch.distance for touch in touches.values()), default=0.0) < -_DEEP
        near = replace(near, problem=larger, start=None if is_deep else before[-1].carried)
        if not (has_more_rows or is_deep):
            break
    return near


def _touches(problem: Problem, t: Array, qs: Array, vs: Array) -> Mapping[str, Approach]:
    """Where things are deepest in each other along a motion."""
    return {} if problem.clearance is None else touches_along(problem.clearance, t, qs, vs)


def _out_of_time(last: Attempt, end: CompilationTimeout) -> Attempt:
    """A rough motion with which there was no time to go on."""
    advice = f"not converged: the time limit passed while {end.doing}; {last.outcome.result.advice}"
    result = replace(last.outcome.result, status=Status.TIME_LIMIT, advice=advice)
    return replace(last, outcome=replace(last.outcome, result=result))


def _count(before: list[Attempt], solution: Solution) -> Solution:
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


@dataclass(eq=False)
class _ClearanceRounds:
    """Solves again, with rows and room at the nodes for what the motion touches, there or between them.

    Attributes
    ----------
    job : Job
    near : Problem
        With the rows and the room that it has by now.
    found : Attempt
        The last one that counts.
    solution : Solution
        Of that.
    best : Solution
        With the rows that it asks for, the least deep in something.
    in_vain : int
        Rounds since then.
    taken : int
        Iterations of all rounds.
    """

    job: Job
    near: Problem
    found: Attempt
    solution: Solution
    best: Solution = field(init=False)
    in_vain: int = 0
    taken: int = field(init=False)

    def __post_init__(self) -> None:
        self.best, self.taken = self.solution, self.solution.iterations

    def run(self) -> Solution:
        """Return a solution that touches nothing, or the one that touches least where that cannot be had."""
        for _ in range(_ROUNDS):
            is_open = self.solution.is_stationary and self.in_vain < _IN_VAIN and not self.job.is_late
            is_long = self.job.brief > 0 and self.taken > _IN_ALL
            if is_long or not is_open or not self._improve():
                break
        spent = self.solution.wall_time_s
        return self.best if self.best is self.solution else retold(self.best, wall_time_s=spent)

    def _improve(self) -> bool:
        """Solve with more rows or more room; return whether that was asked for, and could be had."""
        lacks = depth_of(self.solution)
        t, qs, vs = self.solution.t, self.solution.qs, self.solution.vs
        touches = _touches(self.near, t, qs, vs) if lacks else {}
        wider = with_rows_and_room(self.near, t, qs, vs, touches)
        if wider is None:
            return False
        larger, has_more_rows = wider
        has_no_start = has_more_rows and lacks > _DEEP
        tried, again = self._solve(larger, None if has_no_start else self.found.carried)
        is_deep = not has_more_rows and min(lacks, depth_of(again)) > _DEEP
        if (is_deep or not again.is_stationary) and not has_no_start:
            tried, again = self._solve(larger, None)  # from the guess, with all that is known
        if not has_more_rows and not again.is_stationary:
            return False
        self.near, self.found = larger, tried
        again = after(self.solution, again, "fewer rows" if has_more_rows else "smaller margins")
        self.solution, self.in_vain = _tell_room(again, larger), self.in_vain + 1
        if has_more_rows or depth_of(self.solution) < depth_of(self.best):
            self.best, self.in_vain = self.solution, 0
        return True

    def _solve(self, problem: Problem, start: Warm) -> tuple[Attempt, Solution]:
        brief = self.job.brief if start is None else self.job.brief or _BRIEF
        tried = attempt(replace(self.job, problem=problem, start=start, brief=brief))
        self.taken += tried.outcome.iterations
        return tried, self.job.read(tried)


def after(before: Solution, again: Solution, name: str) -> Solution:
    """A solution that was found after another; what both took."""
    spent = before.wall_time_s
    return retold(
        again,
        guess_used=before.guess_used,
        starts=before.starts,
        iterations=before.iterations + again.iterations,
        phases=(Phase(name, before.iterations, spent), *again.phases),
        wall_time_s=spent + again.wall_time_s,
    )


def _tell_room(solution: Solution, problem: Problem) -> Solution:
    """The solution; its advice says how much room there is beyond the margins."""
    raised = 1e3 * largest_reserve(problem)
    if not raised:
        return solution
    words = f"margins at nodes were raised by {raised:.3g} mm in all to be clear between them"
    return retold(solution, advice=f"{solution.advice}; {words}")
