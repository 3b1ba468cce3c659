"""Solving from one guess after the other, until one of them leads to a solution."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import chain

from mbocp.exceptions import CompilationTimeout, ProblemError
from mbocp.formulation import Formulation
from mbocp.guesses.eased import GIVEN_SOLUTIONS, better_of_eased
from mbocp.guesses.kinds import none_made
from mbocp.guesses.ranking import is_better, with_end
from mbocp.guesses.starts import Warm, guesses_in_turn, last_guesses
from mbocp.solvers import (
    IterationRecord,
    Outcome,
    Phase,
    SolverSettings,
    Start,
    Status,
    run_strategy,
)
from mbocp.solvers.newton_method.polish import can_be_polished
from mbocp.solvers.records import timed
from mbocp.solvers.strategies.patience import Patience

_BRIEF = 40  # iterations from a warm start, before other guesses: most take less than half of them


def solve_from_guesses(
    formulation: Formulation,
    warm_start: Warm,
    callback: Callable[[IterationRecord], object] | None,
    phases: list[Phase],
    deadline: float,
    rough: float = 0.0,
    *,
    is_brief: bool = False,
    patience: Patience | None = None,
) -> tuple[Outcome, str]:
    """Run the solver from the guess; where the guess was left to mbocp, from the next one if that fails.

    `rough`: residual with which Newton's method may end; the first guess is the only one then. `is_brief`:
    whether a few iterations of Newton's method have to do, where the method is left to mbocp. `patience`: of
    all attempts at the problem; None: of these alone.
    """
    problem, programme = formulation.problem, formulation.programme
    threads, is_bounded = problem.solver.num_threads, problem.is_bounded
    settings = SolverSettings.of(problem.solver, programme, has_inequalities=is_bounded, threads=threads)
    settings = replace(settings, rough=rough)
    if is_brief and settings.options.method == "auto" and can_be_polished(programme):
        brief = replace(settings.options, method="monolithic", max_iterations=_BRIEF)
        settings = replace(settings, options=brief)
    patience = patience or Patience(is_limited=math.isinf(deadline))
    best: tuple[Outcome, str] | None = None
    history: list[IterationRecord] = []
    failed: dict[str, ProblemError] = {}
    in_turn = guesses_in_turn(formulation, warm_start)
    last = (guess for guess in last_guesses(formulation, warm_start) if best is None)
    for attempt, (kind, make) in enumerate(chain(in_turn, last)):
        try:
            with timed(phases, "guess"):
                iterate, words = make(deadline)
        except ProblemError as error:
            failed[kind] = error  # no reason to give up on the others
            continue
        except CompilationTimeout:
            if best is None:
                raise
            break
        except KeyboardInterrupt:
            if best is None:
                raise  # there is nothing to return yet
            best = (interrupted(best[0]), best[1])
            break
        is_doubtful = best is not None and best[0].result.status is Status.INFEASIBLE
        start = Start(
            programme,
            iterate,
            callback,
            first=sum(not record.is_guess for record in history),
            label="" if attempt == 0 else f" (guess: {kind})",
            patience=patience,
        )
        limited = replace(settings, time_limit=_time_left(deadline), is_doubtful=is_doubtful)
        outcome = run_strategy(limited, start)
        if rough:
            phases += outcome.phases
            return outcome, words
        has_failed = outcome.result.status is not Status.CONVERGED
        if attempt == 0 and kind not in GIVEN_SOLUTIONS and not (has_failed and patience.is_over):
            until = min(deadline, time.perf_counter() + patience.left) if has_failed else deadline
            remaining, before = replace(limited, time_limit=_time_left(until)), time.perf_counter()
            outcome = better_of_eased(formulation, remaining, start, outcome)
            patience.spend(time.perf_counter() - before)
        outcome = with_end(formulation, outcome)
        history += outcome.result.history
        phases += outcome.phases
        result = outcome.result
        if best is None or result.status is Status.CONVERGED or is_better(result, best[0].result):
            best = (outcome, words)
        elif result.status is Status.INTERRUPTED:
            best = (interrupted(best[0]), best[1])
        if patience.is_over or result.status in (Status.CONVERGED, Status.INTERRUPTED, Status.TIME_LIMIT):
            break
    if best is None:
        raise none_made(failed)
    outcome, words = best
    words += "".join(f"; {kind!r} could not be made" for kind in failed)
    return replace(outcome, result=replace(outcome.result, history=tuple(history))), words


def interrupted(outcome: Outcome) -> Outcome:
    """Outcome of an earlier guess, returned because a later one was interrupted."""
    return replace(outcome, result=outcome.result.interrupted())


def _time_left(deadline: float) -> float | None:
    """Time until a deadline [s]; None: there is none."""
    return None if math.isinf(deadline) else max(0.0, deadline - time.perf_counter())
