"""Solving from one guess after the other, until one of them leads to a solution."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

from mbocp.exceptions import ProblemError
from mbocp.formulation import Formulation
from mbocp.formulation.end_reached import end_missed
from mbocp.guesses.from_solution import iterate_from_solution
from mbocp.guesses.kinds import guess_candidates
from mbocp.guesses.make import make_guess
from mbocp.solution import Solution
from mbocp.solvers import (
    IterationRecord,
    Outcome,
    Phase,
    SolverResult,
    SolverSettings,
    Start,
    Status,
    run_strategy,
)
from mbocp.solvers.records import timed

__all__ = ["interrupted", "is_better", "solve_from_guesses", "with_end"]


def solve_from_guesses(
    formulation: Formulation,
    warm_start: Solution | None,
    callback: Callable[[IterationRecord], object] | None,
    phases: list[Phase],
    deadline: float,
) -> tuple[Outcome, str]:
    """Run the solver from the guess; where the guess was left to mbocp, from the next one if that fails."""
    problem, programme = formulation.problem, formulation.programme
    settings = SolverSettings.of(problem.solver, programme, has_inequalities=problem.is_bounded)
    best: tuple[Outcome, str] | None = None
    history: list[IterationRecord] = []
    kinds = ("warm start",) if warm_start is not None else guess_candidates(problem)
    for attempt, kind in enumerate(kinds):
        try:
            with timed(phases, "guess"):
                if warm_start is not None:
                    iterate = iterate_from_solution(warm_start, formulation)
                    words = "warm start from a solution"
                else:
                    iterate, words = make_guess(kind, formulation)
        except ProblemError:
            if attempt + 1 < len(kinds) or best is not None:
                continue  # an automatic guess that cannot be made is no reason to give up on the others
            raise
        except KeyboardInterrupt:
            if best is None:
                raise  # there is nothing to return yet
            best = (interrupted(best[0]), best[1])
            break
        is_doubtful = best is not None and best[0].result.status is Status.INFEASIBLE
        left = None if math.isinf(deadline) else max(0.0, deadline - time.perf_counter())
        start = Start(
            programme,
            iterate,
            callback,
            first=sum(not record.is_guess for record in history),
            label="" if attempt == 0 else f" (guess: {kind})",
        )
        outcome = run_strategy(replace(settings, time_limit=left, is_doubtful=is_doubtful), start)
        outcome = with_end(formulation, outcome)
        history += outcome.result.history
        phases += outcome.phases
        result = outcome.result
        if best is None or result.status is Status.CONVERGED or is_better(result, best[0].result):
            best = (outcome, words)
        elif result.status is Status.INTERRUPTED:
            best = (interrupted(best[0]), best[1])
        if result.status in (Status.CONVERGED, Status.INTERRUPTED, Status.TIME_LIMIT):
            break
    if best is None:
        raise ProblemError("no initial guess could be made; give guess.kind and guess.u")
    outcome, words = best
    return replace(outcome, result=replace(outcome.result, history=tuple(history))), words


def with_end(formulation: Formulation, outcome: Outcome) -> Outcome:
    """Outcome that says so where it ends beside the goal; at another root it has not converged."""
    result = outcome.result
    if result.status is not Status.CONVERGED:
        return outcome
    missed = end_missed(formulation, formulation.motion_of(result.iterate).qs)
    if missed is None:
        return outcome
    status = Status.OTHER_ROOT if missed.is_other_root else result.status
    return replace(outcome, result=replace(result, status=status, advice=f"{result.advice}; {missed.words}"))


def interrupted(outcome: Outcome) -> Outcome:
    """Outcome of an earlier guess, returned because a later one was interrupted."""
    return replace(outcome, result=outcome.result.interrupted())


def is_better(new: SolverResult, old: SolverResult) -> bool:
    """Whether one of two results that have not converged says more: another root, then `infeasible`."""
    if Status.OTHER_ROOT in (new.status, old.status):
        return old.status is not Status.OTHER_ROOT
    if old.status is Status.INFEASIBLE:
        return False
    return new.record.residual < old.record.residual
