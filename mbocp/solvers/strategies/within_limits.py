"""The strategy `auto` where there are limits, which are left out first, and brought back in parts.

An interior-point method cuts its steps short of every limit. From a guess that is far from feasible it may
so creep to a point where linearised equations and limits cannot both hold, and call a problem infeasible that
is not. The same problem without limits often has a solution at hand, by full Newton steps. From there limits
are brought back: at once where the motion keeps them nearly, else first so wide that it keeps them, and then
closer part by part, each time from the solution before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import groupby

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import CompilationTimeout
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.solvers.newton_method.limit_multipliers import compute_bounded_values, explain_limits_not_kept
from mbocp.solvers.records import Status
from mbocp.solvers.strategies.auto import has_stalled, is_nearly_feasible, run_auto
from mbocp.solvers.strategies.interior import run_interior
from mbocp.solvers.strategies.iterating import SolverResult
from mbocp.solvers.strategies.phases import Outcome, Phases, describe_end
from mbocp.solvers.strategies.registry import make_solver

# Iterations without progress: many motions within limits go on after forty, and IPOPT takes as long for ten.
_PATIENCE = 80
_WITHOUT, _WIDER = " without limits", " with wider limits"  # behind the names of phases
_MOST_RUNS, _MOST_FAILURES = 8, 2

Solve = Callable[[StagewiseProgramme, Iterate], SolverResult | None]

_has_stalled = partial(has_stalled, window=_PATIENCE)


def run_auto_within_limits(phases: Phases) -> Outcome:
    """Run monolithic Newton with its barrier; if it stalls, what else may help.

    From a point far from feasible the problem without limits comes first: its solution may keep them, or
    nearly. Then IPOPT, which knows the infeasible, unless other guesses come before it. In the end limits are
    brought back part by part.
    """
    programme, settings = phases.programme, phases.settings
    if explain_limits_not_kept(programme) is not None:
        found, title = run_interior("ipopt", phases)
        return phases.outcome(found, f"auto: {title}")
    if phases.before is not None:
        return _go_on(phases, phases.before, None)
    solver = make_solver("monolithic", settings.with_patience())
    begun, free = phases.run(solver, "monolithic", phases.guess, should_stop=_has_stalled), None
    if phases.ends_with(begun):
        return phases.outcome(begun, f"auto: {solver.name}")
    if can_leave_out_limits(programme) and not is_nearly_feasible(begun.history):
        free = _run_newton(phases.on(without_limits(programme), _WITHOUT), phases.guess)
        last = _keep_limits_at_once(phases, free)
        if last is not None or phases.is_in_vain:
            return phases.outcome(_with_all_limits(last, begun), _title(phases), _words(begun))
    if settings.is_newton_alone:
        return phases.outcome(begun, _title(phases))
    return _go_on(phases, begun, free)


def _go_on(phases: Phases, begun: SolverResult, free: SolverResult | None) -> Outcome:
    """Run what else may help, where Newton's method makes no progress.

    `free` is what it has made of the problem without limits, if it was asked.
    """
    found, words, title = begun, _words(begun), _title(phases)
    if not phases.settings.is_doubtful:
        try:
            found, name = run_interior("ipopt", phases)
        except CompilationTimeout:
            advice = f"no time was left for IPOPT: raise solver.time_limit; before: {begun.advice}"
            late = replace(begun, status=Status.TIME_LIMIT, advice=advice)
            return phases.outcome(late, title, words)
        title = f"{title} > {name}" if phases.names[:-1] else f"auto: {name}"
        if found.status is Status.STAGNATED and begun.record.residual < found.record.residual:
            found, words = begun, f"{words}, ipopt {describe_end(found)}"
        if phases.ends_with(found):
            return phases.outcome(found, title, words)
    last = _bring_limits_back(phases, free) if can_leave_out_limits(phases.programme) else None
    if last is not None:
        found, title = _with_all_limits(last, found), _title(phases)
    return phases.outcome(found, title, words)


def _words(begun: SolverResult) -> str:
    return f"auto: monolithic {describe_end(begun)}"


def _bring_limits_back(phases: Phases, free: SolverResult | None) -> SolverResult | None:
    """Go by way of the problem without limits; return what was stopped, or None if it leads nowhere.

    `free` is what Newton's method has made of the problem without limits, if it was asked. Where a
    problem may be infeasible, parts are not gone through from every guess.
    """
    programme = phases.programme
    if free is None or free.status is not Status.CONVERGED:
        free = run_auto(phases.on(without_limits(programme), _WITHOUT)).result
        last = _keep_limits_at_once(phases, free)
        if last is not None:
            return last
    if free.status is not Status.CONVERGED or phases.settings.is_doubtful:
        return None

    def solve(wanted: StagewiseProgramme, start: Iterate) -> SolverResult | None:
        if phases.is_in_vain:
            return None
        return _run_newton(phases if wanted is programme else phases.on(wanted, _WIDER), start)

    return bring_limits_back(programme, free.iterate, solve)


def _keep_limits_at_once(phases: Phases, free: SolverResult) -> SolverResult | None:
    """Solve with all limits from a solution without; return what was stopped, or None if it leads nowhere."""
    if free.status is Status.CONVERGED and not phases.settings.is_spent(phases.taken):
        found = _run_newton(phases, free.iterate)
        return found if found.status is Status.CONVERGED or found.status.is_stopped else None
    return free if free.status.is_stopped else None


def _run_newton(phases: Phases, iterate: Iterate) -> SolverResult:
    """Run monolithic Newton while it makes progress."""
    solver = make_solver("monolithic", phases.settings.within(phases.taken))
    return phases.run(solver, "monolithic", iterate, should_stop=_has_stalled)


def _with_all_limits(found: SolverResult | None, before: SolverResult) -> SolverResult:
    """A solution; else what came before, which knew all limits, with why there is no better."""
    if found is None or found.status is Status.CONVERGED:
        return found or before
    return replace(before, status=found.status, advice=found.advice)


def _title(phases: Phases) -> str:
    """The phases in words, each once where several of a name follow each other."""
    return "auto: " + " > ".join(name for name, _ in groupby(phases.names))


def can_leave_out_limits(programme: StagewiseProgramme) -> bool:
    """Whether there are limits to leave out, and the problem still means something without them.

    Free step lengths need theirs: a step of negative length is none.
    """
    has_some = bool((programme.bounds.has_limit & ~programme.bounds.are_equations).any())
    return has_some and not programme.has_free_lengths and explain_limits_not_kept(programme) is None


def without_limits(programme: StagewiseProgramme) -> StagewiseProgramme:
    """The programme with equations alone."""
    bounds = programme.bounds
    keep = bounds.are_equations
    return replace(
        programme,
        bounds=bounds.with_sides(np.where(keep, bounds.lower, -np.inf), np.where(keep, bounds.upper, np.inf)),
    )


def measure_excess(programme: StagewiseProgramme, iterate: Iterate) -> tuple[Array, Array]:
    """Return how far an iterate goes beyond its limits at most, by row: below and above, (nx + nu + nh,)."""
    bounds = programme.bounds
    lower, upper = bounds.lower, bounds.upper
    values, is_limit = compute_bounded_values(programme, iterate), ~bounds.are_equations
    below = np.where(is_limit & np.isfinite(lower), lower - values, 0.0)
    above = np.where(is_limit & np.isfinite(upper), values - upper, 0.0)
    return below.max(axis=0, initial=0.0), above.max(axis=0, initial=0.0)


def widen(programme: StagewiseProgramme, width: tuple[Array, Array], part: float) -> StagewiseProgramme:
    """Return the programme with limits farther out by a part of `width`, below and above."""
    bounds = programme.bounds
    return replace(
        programme, bounds=bounds.with_sides(bounds.lower - part * width[0], bounds.upper + part * width[1])
    )


def bring_limits_back(programme: StagewiseProgramme, iterate: Iterate, solve: Solve) -> SolverResult | None:
    """Solve with all limits, from a solution without; return what was stopped, or None if it leads nowhere.

    `solve` returns None where it may not go on.
    """
    width = measure_excess(programme, iterate)
    reached, step, failures = 1.0, 0.5, 0
    for _ in range(_MOST_RUNS):
        part = max(0.0, reached - step)
        found = solve(programme if part == 0.0 else widen(programme, width, part), iterate)
        if found is None:
            return None
        if found.status.is_stopped or (part == 0.0 and found.status is Status.CONVERGED):
            return found
        if found.status is Status.CONVERGED:
            reached, iterate = part, found.iterate
        else:
            step, failures = 0.5 * step, failures + 1
            if failures > _MOST_FAILURES:
                return None
    return None
