"""Further descents where effort alone costs: from the optimum with a weight on velocities that fades.

From a guess Newton's method falls into the next minimum, of which there are many where light links spin for
next to nothing. The same problem with a weight on velocities has few, and is solved in a few iterations. Its
optimum is followed while the weight fades, and the solve goes on from there. Then other ways are tried with
few steps, see `screening`. The best of all ends counts: the cheapest motion that the steps resolve. What
converges in a few iterations is left as it is.
"""

from __future__ import annotations

from dataclasses import field, replace

import numpy as np

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp.formulation import Formulation
from mbocp.guesses.screening import Screening, can_screen, is_preferred, status_of, with_end
from mbocp.solvers import Outcome, SolverSettings, Start, Status, run_strategy
from mbocp.solvers.records import deadline_after, time_until
from mbocp.solvers.strategies.phases import describe_end

GIVEN_SOLUTIONS = ("warm start", "solution")  # guesses with a minimum of their own, which is wanted
_SHARES = (0.1, 1e-3)  # of the weight "auto": that of the first leaves effort a good part of the cost
_SHARES_OF_FURTHER = (1e-3,)  # so small that other guesses lead to other optima
_FEW = 15  # iterations: what takes no more has been near its minimum from the start
_MOST = 60  # iterations with one weight; where more are needed, there is nothing to follow
_ROUGH = 1e-5  # tolerance on the way: its points are where the next weight begins


@dataclass(frozen=True, eq=False)
class _Run:
    """A solve with a share of the weights, and what it came to."""

    share: float
    outcome: Outcome

    @property
    def is_solved(self) -> bool:
        return self.outcome.result.status is Status.CONVERGED


def try_easing(
    formulation: Formulation, settings: SolverSettings, start: Start, plain: Outcome, *, number: int = 0
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
    easing = formulation.programme.easing
    if easing is None or not _may_ease(formulation, settings, plain):
        return plain
    descent = _Descent(formulation, settings, start, plain, easing, number)
    try:
        descent.fade()
        descent.screen()
    except KeyboardInterrupt:
        descent.is_interrupted = True
    return descent.end()


def _may_ease(formulation: Formulation, settings: SolverSettings, plain: Outcome) -> bool:
    """Whether the method is left to mbocp, and the plain solve has neither been stopped nor been easy."""
    is_left_to_us = settings.options.method == "auto" and settings.options.max_iterations is None
    if not is_left_to_us or plain.result.status.is_stopped:
        return False
    return plain.iterations > _FEW or status_of(formulation, plain) is not Status.CONVERGED


@dataclass(eq=False)
class _Descent:
    """Further solves from one guess, and the best outcome so far.

    Attributes
    ----------
    formulation, settings, start, plain, number
        As `try_easing` has them.
    easing : ndarray, shape (ntheta,)
        What the full weight on velocities adds to the parameters of the stages.
    runs : list of _Run
        Solves with weights, and without in the end.
    screening : Screening, optional
        Trials with few steps.
    best : Outcome
    is_interrupted : bool
        Whether somebody pressed Ctrl-C between solves.
    """

    formulation: Formulation
    settings: SolverSettings
    start: Start
    plain: Outcome
    easing: Array
    number: int
    runs: list[_Run] = field(default_factory=list)
    screening: Screening | None = None
    best: Outcome = field(init=False)
    is_interrupted: bool = False

    def __post_init__(self) -> None:
        self.best, self._deadline = self.plain, deadline_after(self.settings.time_limit)

    def fade(self) -> None:
        """Run after run with fading weights, at last without, each from the end of the one before."""
        options = replace(self.settings.options, method="monolithic")
        rough = replace(options, tolerance=max(options.tolerance, _ROUGH), max_iterations=_MOST)
        programme, iterate = self.start.programme, self.start.iterate
        for share in (*(_SHARES_OF_FURTHER if self.number else _SHARES), 0.0):
            weighed = replace(programme, theta=frozen_array(programme.theta + share * self.easing))
            words = f"velocity weighed {share:g} of auto" if share else "eased"
            label = f" ({words}){self.start.label}"
            limited = replace(
                self.settings, options=rough if share else options, time_limit=time_until(self._deadline)
            )
            start = replace(
                self.start, programme=weighed, iterate=iterate, first=self._first, label=label, before=None
            )
            outcome = run_strategy(limited, start)
            self.runs.append(_Run(share, outcome))
            if not self.runs[-1].is_solved:
                return
            iterate = outcome.result.iterate
        self._take(outcome)

    def screen(self) -> None:
        """Try other ways with few steps, and take the best."""
        if not can_screen(self.formulation) or self.runs[-1].outcome.result.status.is_stopped:
            return
        limited = replace(self.settings, time_limit=time_until(self._deadline))
        after = replace(self.start, first=self._first)
        self.screening = Screening(self.formulation, limited, after, self.number)
        best = self.screening.best(self.best)
        if best is not self.best:
            self.best = self._with_words(best, "reached by one of the ways tried with fewer steps")

    def end(self) -> Outcome:
        """Return the best outcome with the iterations of all."""
        further = self.screening.runs if self.screening else ()
        solves = [self.plain, *(run.outcome for run in self.runs), *further]
        is_interrupted = self.is_interrupted or solves[-1].result.status is Status.INTERRUPTED
        result = self.best.result.with_interrupt() if is_interrupted else self.best.result
        if status_of(self.formulation, self.best) is Status.UNDER_RESOLVED:
            result = replace(result, advice=result.advice + self._describe_weight())
        history = tuple(record for outcome in solves for record in outcome.result.history)
        phases = tuple(phase for outcome in solves for phase in outcome.phases)
        return Outcome(replace(result, history=history), phases, self.best.solver)

    @property
    def _first(self) -> int:
        """Iterations before the next run."""
        taken = sum(run.outcome.iterations for run in self.runs)
        return self.start.first + self.plain.iterations + taken

    def _take(self, eased: Outcome) -> None:
        """Take the end of the last run, of the problem itself, if it is better than the plain one."""
        known = (self.formulation, with_end(self.formulation, self.plain))
        if is_preferred(self.formulation, with_end(self.formulation, eased), known):
            self.best = self._with_words(eased, "reached while a weight on velocities faded")

    def _with_words(self, best: Outcome, words: str) -> Outcome:
        """Say how an outcome was reached, and what comes straight from the guess."""
        plain = self.plain.result
        without = f"(straight from the guess: {describe_end(plain)}, cost {plain.record.cost:.6g})"
        return replace(best, result=replace(best.result, advice=f"{best.result.advice}; {words} {without}"))

    def _describe_weight(self) -> str:
        """Words for the smallest weight whose optimum the steps resolve, if one is known."""
        for run in reversed(self.runs):
            if run.share and run.is_solved and status_of(self.formulation, run.outcome) is Status.CONVERGED:
                weight = run.share * float(np.max(self.easing))
                return f"; with cost.velocity = {weight:.3g} the steps resolve the optimum"
        return ""
