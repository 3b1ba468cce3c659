"""The strategy `auto`: Newton's method while it makes progress, then what else may help."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from mbocp.programme.iterate import Iterate
from mbocp.solvers.options import Switch
from mbocp.solvers.records import IterationRecord, Status
from mbocp.solvers.strategies.iterating import SolverResult
from mbocp.solvers.strategies.phases import Outcome, Phases, describe_end
from mbocp.solvers.strategies.registry import make_solver

_PATIENCE = 200  # iterations without progress, of the phase after which there is no other
_GRADIENT_STEPS = 25  # of the gradient phases, as in the paper's hybrids
_WINDOW = 40  # iterations in which progress is wanted ...
_PROGRESS = 0.5  # ... by this factor in the residual, ...
_GAIN = 0.02  # ... or by this part of the cost, ...
_FEASIBLE_PART = 0.5  # ... while violations are no more than this part of the residual
_SLOW_GAIN = 1e-4  # of the cost: what is far above round-off gets ...
_LONG_WINDOW = 100  # ... more iterations, if the motion is nearly feasible
_NEARLY = 0.1  # of the largest violation on the way: less is nearly feasible
_LATELY = 10  # iterations: violations go up and down from step to step, and the smallest of a few counts


def run_auto(phases: Phases) -> Outcome:
    """Run monolithic Newton; if it stalls, the hybrids; in the end resume the first run.

    Every phase says in the advice why it ended. Nothing is given up for good: where no other strategy
    succeeds, the first goes on from its best iterate.
    """
    runs = _Runs(phases)
    first = runs.go_on("monolithic", phases.guess)
    runs.go_on("fbsm_bb", phases.guess)
    if not runs.is_over and runs.results[-1].status is not Status.SWEEP_FAILED:
        reached = runs.results[-1].iterate
        runs.go_on("fbsm_newton", reached)
        runs.go_on("monolithic", reached)
    if first.status is Status.STAGNATED:
        runs.go_on("monolithic", first.iterate, is_last=True)
    return runs.outcome()


@dataclass(eq=False)
class _Runs:
    """The phases so far.

    Attributes
    ----------
    phases : Phases
    results : list of SolverResult
    tried : list of (str, str)
        Names of the phases, and of their solvers.
    """

    phases: Phases
    results: list[SolverResult] = field(default_factory=list)
    tried: list[tuple[str, str]] = field(default_factory=list)

    @property
    def is_over(self) -> bool:
        """Whether no further phase is to begin."""
        return bool(self.results) and self.phases.ends_with(self.results[-1])

    def go_on(self, name: str, start: Iterate, *, is_last: bool = False) -> SolverResult:
        """Run a phase while it makes progress, unless it is over; return the last result."""
        if self.is_over:
            return self.results[-1]
        switch = Switch(0.0, 0.0, _GRADIENT_STEPS) if name == "fbsm_bb" else None
        limited = replace(self.phases.settings.within(self.phases.taken), is_careful=is_last)
        solver = make_solver(name, limited.with_patience() if name == "monolithic" else limited, switch)
        watch = partial(has_stalled, window=_PATIENCE if is_last else _WINDOW) if switch is None else None
        self.tried.append((name, solver.name))
        self.results.append(self.phases.run(solver, name, start, should_stop=watch))
        return self.results[-1]

    def outcome(self) -> Outcome:
        """Return the best result, and say how each phase ended."""
        phases = self.phases
        best = _best(self.results, is_spent=phases.settings.is_spent(phases.taken))
        if len(self.results) == 1:
            return phases.outcome(best, f"auto: {self.tried[0][1]}")
        ends = zip(self.tried, self.results, strict=True)
        words = ", ".join(f"{name} {describe_end(result)}" for (name, _), result in ends)
        return phases.outcome(best, "auto: " + " > ".join(phases.names), f"auto: {words}")


def _best(results: Sequence[SolverResult], *, is_spent: bool) -> SolverResult:
    """The converged one, which is the last; else that with the smallest residual, and why there is no better.

    `is_spent`: the limit of iterations is used up.
    """
    last = results[-1]
    if last.status is Status.CONVERGED:
        return last
    best = min(results, key=lambda r: r.record.residual if math.isfinite(r.record.residual) else math.inf)
    if last.status is Status.INTERRUPTED:
        return last if best is last else best.with_interrupt()
    if last.status is Status.TIME_LIMIT:
        return replace(best, status=last.status, advice=last.advice)
    if is_spent and best.status is not Status.MAX_ITERATIONS:
        reached = f"not converged within solver.max_iterations (residual {best.record.residual:.1e})"
        advice = f"{reached}; raise it; what came nearest ended so: {best.advice}"
        return replace(best, status=Status.MAX_ITERATIONS, advice=advice)
    return replace(best, status=last.status, advice=last.advice) if best.status is Status.SWITCHED else best


def has_stalled(history: Sequence[IterationRecord], window: int = _WINDOW) -> bool:
    """Whether over the last iterations neither the residual has halved nor the cost fallen by much.

    Far from a minimum the residual may stand still for long while the cost falls from step to step. Near a
    saddle, where the Hessian is indefinite and the gradient small, the cost falls by little at first.
    """
    if not _stands_still(history, window):
        return False
    before, now = history[-window - 1], history[-1]
    is_slow = before.cost - now.cost > _SLOW_GAIN * abs(before.cost) and is_nearly_feasible(history)
    return not is_slow or (len(history) > _LONG_WINDOW and _stands_still(history, max(window, _LONG_WINDOW)))


def is_nearly_feasible(history: Sequence[IterationRecord]) -> bool:
    """Whether a run violates its equations no more than by a small part of what it has on its way."""
    return _least_violation(history) <= _NEARLY * max(r.primal for r in history)


def _stands_still(history: Sequence[IterationRecord], window: int) -> bool:
    if len(history) <= window:
        return False
    residuals = [r.residual if math.isfinite(r.residual) else math.inf for r in history]
    if min(residuals[-window:]) <= _PROGRESS * min(residuals[:-window]):
        return False
    before, now = history[-window - 1], history[-1]
    is_feasible = _least_violation(history) <= max(_FEASIBLE_PART * now.residual, before.primal)
    return not (is_feasible and now.cost < before.cost - _GAIN * abs(before.cost))


def _least_violation(history: Sequence[IterationRecord]) -> float:
    return min(r.primal for r in history[-_LATELY:])
