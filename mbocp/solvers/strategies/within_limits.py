"""The strategy `auto` where there are limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import groupby

from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.solvers.newton_method.limits import why_limits_cannot_be_kept
from mbocp.solvers.records import Status
from mbocp.solvers.settings import SolverSettings
from mbocp.solvers.strategies.homotopy import brought_back, can_leave_out_limits, without_limits
from mbocp.solvers.strategies.interior import run_interior
from mbocp.solvers.strategies.iterating import SolverResult
from mbocp.solvers.strategies.phases import STOPPED, Outcome, Phases, how_it_ended
from mbocp.solvers.strategies.progress import has_stalled, is_nearly_feasible
from mbocp.solvers.strategies.registry import make_solver

_WITHOUT, _WIDER = " without limits", " with wider limits"  # behind the names of phases

SolveFreely = Callable[[SolverSettings, Iterate, Phases], Outcome]


def solve_within_limits(
    settings: SolverSettings, iterate: Iterate, phases: Phases, solve_freely: SolveFreely
) -> Outcome:
    """Monolithic Newton with its barrier while it makes progress; else what else may help.

    From a point far from feasible the problem without limits comes first: its solution may keep them, or
    nearly. Then IPOPT, which knows the infeasible. At last limits are brought back part by part.

    Parameters
    ----------
    settings : SolverSettings
    iterate : Iterate
        Guess.
    phases : Phases
    solve_freely : callable
        Strategy for problems without limits.
    """
    programme = phases.programme
    if why_limits_cannot_be_kept(programme) is not None:
        found, title = run_interior(settings, "ipopt", iterate, phases)
        return phases.outcome(found, f"auto: {title}")
    solver = make_solver("monolithic", settings.unhurried())
    begun = phases.run(solver, "monolithic", iterate, should_stop=has_stalled)
    if _is_over(settings, phases, begun):
        return phases.outcome(begun, f"auto: {solver.name}")
    told, may_leave_out, free = (
        f"auto: monolithic {how_it_ended(begun)}",
        can_leave_out_limits(programme),
        None,
    )
    if may_leave_out and not is_nearly_feasible(begun.history):
        free = _newton(settings, phases.on(without_limits(programme), _WITHOUT), iterate)
        last = _at_once(settings, phases, free)
        if last is not None or settings.is_spent(phases.taken) or phases.is_in_vain:
            return phases.outcome(_of_all_limits(last, begun), _title(phases), told)
    found, title = begun, f"auto: {solver.name}"
    if not settings.is_doubtful:
        before = _title(phases)
        found, name = run_interior(settings, "ipopt", iterate, phases)
        title = f"{before} > {name}"
        is_better = found.status is Status.STAGNATED and begun.record.residual < found.record.residual
        if is_better:
            found, told = begun, f"{told}, ipopt {how_it_ended(found)}"
        if _is_over(settings, phases, found):
            return phases.outcome(found, title, told)
    if may_leave_out and not phases.is_in_vain:
        last = _by_parts(settings, phases, iterate, free, solve_freely)
        if last is not None:
            found, title = _of_all_limits(last, found), _title(phases)
    return phases.outcome(found, title, told)


def _at_once(settings: SolverSettings, phases: Phases, free: SolverResult) -> SolverResult | None:
    """Solution with all limits from that without; or what was stopped; None where it leads nowhere."""
    if free.status is Status.CONVERGED and not settings.is_spent(phases.taken):
        found = _newton(settings, phases, free.iterate)
        return found if found.status in (Status.CONVERGED, *STOPPED) else None
    return free if free.status in STOPPED else None


def _by_parts(
    settings: SolverSettings,
    phases: Phases,
    iterate: Iterate,
    free: SolverResult | None,
    solve_freely: SolveFreely,
) -> SolverResult | None:
    """Solution by way of the problem without limits; or where that was stopped; None where it leads nowhere.

    `free` is what Newton's method has made of the problem without limits, if it was asked. Where a problem
    may be infeasible, parts are not gone through from every guess.
    """
    programme = phases.programme
    if free is None or free.status is not Status.CONVERGED:
        account = phases.on(without_limits(programme), _WITHOUT)
        free = solve_freely(settings, iterate, account).result
        last = _at_once(settings, phases, free)
        if last is not None:
            return last
    if free.status is not Status.CONVERGED or settings.is_doubtful:
        return None

    def solve(wanted: StagewiseProgramme, start: Iterate) -> SolverResult | None:
        if settings.is_spent(phases.taken) or phases.is_in_vain:
            return None
        account = phases if wanted is programme else phases.on(wanted, _WIDER)
        return _newton(settings, account, start)

    return brought_back(programme, free.iterate, solve)


def _newton(settings: SolverSettings, phases: Phases, iterate: Iterate) -> SolverResult:
    """Monolithic Newton while it makes progress."""
    solver = make_solver("monolithic", settings.within(phases.taken))
    return phases.run(solver, "monolithic", iterate, should_stop=has_stalled)


def _is_over(settings: SolverSettings, phases: Phases, found: SolverResult) -> bool:
    is_spent = settings.is_spent(phases.taken) or phases.is_in_vain
    return is_spent or found.status in (Status.CONVERGED, *STOPPED)


def _of_all_limits(found: SolverResult | None, before: SolverResult) -> SolverResult:
    """A solution; else what came before, which knew all limits, with why there is no better."""
    if found is None or found.status is Status.CONVERGED:
        return found or before
    return replace(before, status=found.status, advice=found.advice)


def _title(phases: Phases) -> str:
    """The phases in words, each once where several of a name follow each other."""
    return "auto: " + " > ".join(name for name, _ in groupby(phases.names))
