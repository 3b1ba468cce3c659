"""Further descents where effort alone costs: from the optimum with a weight on velocities that fades.

From a guess Newton's method falls into the next minimum, of which there are many where light links spin for
next to nothing. The same problem with a weight on velocities has few, and is solved in a few iterations. Its
optimum is followed while the weight fades, and the solve goes on from there. Then other ways are tried with
few steps, see `screening`. The best of all ends counts: the cheapest motion that the steps resolve. What
converges in a few iterations is left as it is.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.formulation import Formulation
from mbocp.guesses.ranking import is_preferred, status_of, with_end
from mbocp.guesses.screening import Screening, can_screen
from mbocp.solvers import Outcome, SolverSettings, Start, Status, run_strategy
from mbocp.solvers.strategies.phases import how_it_ended

GIVEN_SOLUTIONS = ("warm start", "solution")  # guesses with a minimum of their own, which is wanted
_SHARES = (0.1, 1e-3)  # of the weight "auto": that of the first leaves effort a good part of the cost
_SHARES_OF_FURTHER = (1e-3,)  # so small that other guesses lead to other optima
_FEW = 15  # iterations: what takes no more has been near its minimum from the start
_MOST = 60  # iterations with one weight; where more are needed, there is nothing to follow
_ROUGH = 1e-5  # tolerance on the way: its points are where the next weight begins
_FINAL = (Status.INTERRUPTED, Status.TIME_LIMIT)


@dataclass(frozen=True, eq=False)
class _Run:
    """A solve with a share of the weights, and what it came to."""

    share: float
    outcome: Outcome

    @property
    def is_solved(self) -> bool:
        return self.outcome.result.status is Status.CONVERGED


def better_of_eased(
    formulation: Formulation,
    settings: SolverSettings,
    start: Start,
    plain: Outcome,
    *,
    number: int = 0,
) -> Outcome:
    """The outcome of a plain solve, or what the eased problem leads to where that is better.

    Parameters
    ----------
    formulation : Formulation
    settings : SolverSettings
        Of the plain solve, with the time that is left after it.
    start : Start
    plain : Outcome
    number : int
        Of the start among several; 0 is the first, or the only one. Further ones begin with a small weight,
        and try other ways.

    Returns
    -------
    outcome : Outcome
        With the iterations of all. The plain one where the method was chosen by name, its iterations are
        limited, the programme cannot be eased, or the solve was easy. Where neither end is resolved by the
        steps, the advice names a weight whose optimum is, if one of those on the way has been.
    """
    is_left_to_us = settings.options.method == "auto" and settings.options.max_iterations is None
    easing = formulation.programme.easing
    if easing is None or not is_left_to_us or plain.result.status in _FINAL:
        return plain
    if plain.iterations <= _FEW and status_of(formulation, plain) is Status.CONVERGED:
        return plain
    deadline = math.inf if settings.time_limit is None else time.perf_counter() + settings.time_limit
    runs: list[_Run] = []
    best, trials, is_interrupted = plain, None, False
    try:
        after = replace(start, first=start.first + plain.iterations)
        _follow(runs, _SHARES_OF_FURTHER if number else _SHARES, settings, after, easing)
        best = _chosen(formulation, plain, runs)
        if can_screen(formulation) and not (runs and runs[-1].outcome.result.status in _FINAL):
            after = replace(after, first=after.first + sum(run.outcome.iterations for run in runs))
            left = None if math.isinf(deadline) else max(0.0, deadline - time.perf_counter())
            trials = Screening(formulation, replace(settings, time_limit=left), after, number)
            best = _told(trials.best(best), best, plain)
    except KeyboardInterrupt:
        is_interrupted = True
    solves = [plain, *(run.outcome for run in runs), *(trials.runs if trials else ())]
    is_interrupted |= solves[-1].result.status is Status.INTERRUPTED
    result = best.result.interrupted() if is_interrupted else best.result
    if status_of(formulation, best) is Status.UNDER_RESOLVED:
        result = replace(result, advice=result.advice + _resolved_weight(formulation, easing, runs))
    history = tuple(record for outcome in solves for record in outcome.result.history)
    phases = tuple(phase for outcome in solves for phase in outcome.phases)
    return Outcome(replace(result, history=history), phases, best.solver)


def _follow(
    runs: list[_Run], shares: Sequence[float], settings: SolverSettings, start: Start, easing: Array
) -> None:
    """Run after run with fading weights, at last without, each from the end of the one before."""
    deadline = math.inf if settings.time_limit is None else time.perf_counter() + settings.time_limit
    options = replace(settings.options, method="monolithic")
    rough = replace(options, tolerance=max(options.tolerance, _ROUGH), max_iterations=_MOST)
    first, iterate = start.first, start.iterate
    for share in (*shares, 0.0):
        programme = replace(start.programme, theta=frozen_array(start.programme.theta + share * easing))
        words = f"velocity weighed {share:g} of auto" if share else "eased"
        left = None if math.isinf(deadline) else max(0.0, deadline - time.perf_counter())
        outcome = run_strategy(
            replace(settings, options=rough if share else options, time_limit=left),
            Start(programme, iterate, start.callback, first, f" ({words}){start.label}"),
        )
        runs.append(_Run(share, outcome))
        if not runs[-1].is_solved:
            return
        first, iterate = first + outcome.iterations, outcome.result.iterate


def _chosen(formulation: Formulation, plain: Outcome, runs: Sequence[_Run]) -> Outcome:
    """The plain outcome, or the last run's where it got to the problem itself and is better."""
    if not runs or runs[-1].share or not runs[-1].is_solved:
        return plain
    end = runs[-1].outcome
    if not is_preferred(formulation, with_end(formulation, end), (formulation, with_end(formulation, plain))):
        return plain
    without = f"{how_it_ended(plain.result)}, cost {plain.result.record.cost:.6g}"
    told = f"reached while a weight on velocities faded (straight from the guess: {without})"
    return replace(end, result=replace(end.result, advice=f"{end.result.advice}; {told}"))


def _told(best: Outcome, before: Outcome, plain: Outcome) -> Outcome:
    """The best outcome, with words where other ways led to it."""
    if best is before:
        return best
    without = f"{how_it_ended(plain.result)}, cost {plain.result.record.cost:.6g}"
    told = f"reached by one of the ways tried with fewer steps (straight from the guess: {without})"
    return replace(best, result=replace(best.result, advice=f"{best.result.advice}; {told}"))


def _resolved_weight(formulation: Formulation, easing: Array, runs: Sequence[_Run]) -> str:
    """Words for the smallest weight whose optimum the steps resolve, if one is known."""
    for run in reversed(runs):
        if run.share and run.is_solved and status_of(formulation, run.outcome) is Status.CONVERGED:
            weight = run.share * float(np.max(easing))
            return f"; with cost.velocity = {weight:.3g} the steps resolve the optimum"
    return ""
