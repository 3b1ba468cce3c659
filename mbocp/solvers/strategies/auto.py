"""The strategy `auto`: Newton's method while it makes progress, then what else may help."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from mbocp.programme.iterate import Iterate
from mbocp.solvers.protocol import Solver
from mbocp.solvers.records import Status
from mbocp.solvers.settings import SolverSettings
from mbocp.solvers.staggered.switch import Switch
from mbocp.solvers.strategies.iterating import SolverResult
from mbocp.solvers.strategies.phases import STOPPED, Outcome, Phases, how_it_ended
from mbocp.solvers.strategies.progress import WINDOW, has_stalled
from mbocp.solvers.strategies.registry import make_solver

_PATIENCE = 200  # iterations without progress, of the phase after which there is no other
_GRADIENT_STEPS = 25  # of the gradient phases, as in the paper's hybrids


def solve_automatically(settings: SolverSettings, iterate: Iterate, phases: Phases) -> Outcome:
    """Monolithic Newton first; then IPOPT where there are limits, or else the staggered solvers."""
    if settings.has_inequalities:
        from mbocp.solvers.strategies.within_limits import solve_within_limits

        return solve_within_limits(settings, iterate, phases, _solve_freely)
    return _solve_freely(settings, iterate, phases)


def _solve_freely(settings: SolverSettings, iterate: Iterate, phases: Phases) -> Outcome:
    """Monolithic Newton while it makes progress; else the hybrids; at last what had been broken off.

    Every phase says in the advice why it ended. Nothing is given up for good: where no other strategy
    succeeds, the first goes on from its best iterate.
    """
    results: list[SolverResult] = []
    tried: list[tuple[str, Solver[Any]]] = []

    def is_over() -> bool:
        is_spent = settings.is_spent(phases.taken) or phases.is_in_vain
        return bool(results) and (is_spent or results[-1].status in (Status.CONVERGED, *STOPPED))

    def attempt(name: str, start: Iterate, *, is_last: bool = False) -> None:
        if is_over():
            return
        switch = Switch(0.0, 0.0, _GRADIENT_STEPS) if name == "fbsm_bb" else None
        limited = replace(settings.within(phases.taken), is_careful=is_last)
        solver = make_solver(name, limited.unhurried() if name == "monolithic" else limited, switch)
        watch = partial(has_stalled, window=_PATIENCE if is_last else WINDOW) if switch is None else None
        tried.append((name, solver))
        results.append(phases.run(solver, name, start, should_stop=watch))

    attempt("monolithic", iterate)
    first = results[0]
    attempt("fbsm_bb", iterate)
    if not is_over() and results[-1].status is not Status.SWEEP_FAILED:
        reached = results[-1].iterate
        attempt("fbsm_newton", reached)
        attempt("monolithic", reached)
    if first.status is Status.STAGNATED:
        attempt("monolithic", first.iterate, is_last=True)
    best = _best(results, is_spent=settings.is_spent(phases.taken))
    if len(results) == 1:
        return phases.outcome(best, f"auto: {tried[0][1].name}")
    told = [f"{name} {how_it_ended(result)}" for (name, _), result in zip(tried, results, strict=True)]
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
        reached = f"not converged within solver.max_iterations (residual {best.record.residual:.1e})"
        advice = f"{reached}; raise it; what came nearest ended so: {best.advice}"
        return replace(best, status=Status.MAX_ITERATIONS, advice=advice)
    return replace(best, status=last.status, advice=last.advice) if best.status is Status.SWITCHED else best
