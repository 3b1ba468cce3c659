"""The strategy `auto`: Newton's method while it makes progress, then what else may help."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from mbocp.programme.iterate import Iterate
from mbocp.solvers.fbsm_gradient import Switch
from mbocp.solvers.interior import run_interior
from mbocp.solvers.limits import why_limits_cannot_be_kept
from mbocp.solvers.phases import STOPPED, Outcome, Phases, how_it_ended
from mbocp.solvers.records import IterationRecord, Status
from mbocp.solvers.registry import make_solver
from mbocp.solvers.run import SolverResult
from mbocp.solvers.settings import SolverSettings

__all__ = ["solve_automatically"]

_WINDOW = 40  # iterations in which `auto` wants progress from Newton's method ...
_PROGRESS = 0.5  # ... by this factor in the residual, ...
_GAIN = 0.02  # ... or by this part of the cost, ...
_FEASIBLE_PART = 0.5  # ... while violations are no more than this part of the residual
_GRADIENT_STEPS = 25  # of the gradient phases, as in the paper's hybrids


def solve_automatically(settings: SolverSettings, iterate: Iterate, phases: Phases) -> Outcome:
    """Monolithic Newton first; then IPOPT where there are limits, or else the staggered solvers."""
    way = _solve_within_limits if settings.has_inequalities else _solve_freely
    return way(settings, iterate, phases)


def _solve_within_limits(settings: SolverSettings, iterate: Iterate, phases: Phases) -> Outcome:
    """Monolithic Newton with its barrier while it makes progress; else IPOPT, which knows the infeasible."""
    told, begun = "", None
    if why_limits_cannot_be_kept(phases.programme) is None:
        solver = make_solver("monolithic", settings)
        begun = phases.run(solver, "monolithic", iterate, should_stop=_has_stalled)
        if settings.is_spent(phases.taken) or begun.status in (Status.CONVERGED, *STOPPED):
            return phases.outcome(begun, f"auto: {solver.name}")
        told = f"auto: monolithic {how_it_ended(begun)}"
        if settings.is_doubtful:
            return phases.outcome(begun, f"auto: {solver.name}", told)
    before = phases.names
    found, title = run_interior(settings, "ipopt", iterate, phases)
    title = "auto: " + " > ".join([*before, title])
    if (
        begun is not None
        and found.status is Status.STAGNATED
        and begun.record.residual < found.record.residual
    ):
        return phases.outcome(begun, title, f"{told}, ipopt {how_it_ended(found)}")
    return phases.outcome(found, title, told)


def _solve_freely(settings: SolverSettings, iterate: Iterate, phases: Phases) -> Outcome:
    """Monolithic Newton while it makes progress; else the hybrids; at last what had been broken off.

    Every phase says in the advice why it ended. Nothing is given up for good: where no other strategy
    succeeds, the first goes on from its best iterate.
    """
    results: list[SolverResult] = []
    told: list[str] = []

    def is_over() -> bool:
        is_spent = settings.is_spent(phases.taken)
        return bool(results) and (is_spent or results[-1].status in (Status.CONVERGED, *STOPPED))

    def attempt(name: str, start: Iterate, *, is_watched: bool = True) -> None:
        if is_over():
            return
        switch = Switch(0.0, 0.0, _GRADIENT_STEPS) if name == "fbsm_bb" else None
        solver = make_solver(name, settings.within(phases.taken), switch)
        results.append(
            phases.run(
                solver, name, start, should_stop=_has_stalled if is_watched and switch is None else None
            )
        )
        told.append(f"{name} {how_it_ended(results[-1])}")

    attempt("monolithic", iterate)
    first = results[0]
    attempt("fbsm_bb", iterate)
    if not is_over() and results[-1].status is not Status.SWEEP_FAILED:
        reached = results[-1].iterate
        attempt("fbsm_newton", reached)
        attempt("monolithic", reached)
    if first.status is Status.STAGNATED:
        attempt("monolithic", first.iterate, is_watched=False)
    best = _best(results, is_spent=settings.is_spent(phases.taken))
    if len(results) == 1:
        return phases.outcome(best, f"auto: {make_solver('monolithic', settings).name}")
    return phases.outcome(best, "auto: " + " > ".join(phases.names), "auto: " + ", ".join(told))


def _best(results: Sequence[SolverResult], *, is_spent: bool) -> SolverResult:
    """The converged one, which is the last; else that with the smallest residual, and why there is no better.

    `is_spent`: the limit of iterations is used up.
    """
    last = results[-1]
    if last.status is Status.CONVERGED:
        return last
    best = min(results, key=lambda r: r.record.residual if math.isfinite(r.record.residual) else math.inf)
    if last.status is Status.INTERRUPTED:
        return last if best is last else best.interrupted()
    if last.status is Status.TIME_LIMIT:
        return replace(best, status=last.status, advice=last.advice)
    if is_spent and best.status is not Status.MAX_ITERATIONS:
        reached = (
            f"not converged within solver.max_iterations (residual {best.record.residual:.1e}); raise it"
        )
        return replace(best, status=Status.MAX_ITERATIONS, advice=reached)
    return replace(best, status=last.status, advice=last.advice) if best.status is Status.SWITCHED else best


def _has_stalled(history: Sequence[IterationRecord]) -> bool:
    """Whether over the last iterations neither the residual has halved nor the cost fallen by much.

    Far from a minimum the residual may stand still for long while the cost falls from step to step.
    """
    if len(history) <= _WINDOW:
        return False
    residuals = [r.residual if math.isfinite(r.residual) else math.inf for r in history]
    if min(residuals[-_WINDOW:]) <= _PROGRESS * min(residuals[:-_WINDOW]):
        return False
    before, now = history[-_WINDOW - 1], history[-1]
    is_feasible = now.primal <= max(_FEASIBLE_PART * now.residual, before.primal)
    return not (is_feasible and now.cost < before.cost - _GAIN * abs(before.cost))
