"""IPOPT or fatrop as a phase: its claim is judged by our own measure, and polished by Newton's method."""

from __future__ import annotations

from dataclasses import replace

from mbocp.solvers.newton_method.monolithic import can_be_polished, judge, meets, polisher
from mbocp.solvers.nlp.interior_point import InteriorPoint
from mbocp.solvers.records import Status
from mbocp.solvers.strategies.iterating import SolverResult
from mbocp.solvers.strategies.phases import Phases, describe_end

_SETTLED = (Status.CONVERGED, Status.LINE_SEARCH_FAILED)  # ends of an interior-point solver at a solution


def run_interior(name: str, phases: Phases) -> tuple[SolverResult, str]:
    """Run IPOPT or fatrop, and Newton's method where that ends too early by our measure; with a title."""
    settings = phases.settings
    solver = InteriorPoint(
        name,
        settings.tolerance,
        settings.interior_iterations(phases.taken),
        phases.time_left,
        settings.options.linear_solver,
        phases.allowance(is_interior=True),
    )
    found = phases.run_interior(solver, name, phases.guess)
    if found.status not in _SETTLED or not can_be_polished(phases.programme):
        return found, solver.title
    judged, error = judge(found, phases.programme, settings.tolerance)
    if error <= settings.tolerance:
        return _claim_converged(judged), solver.title
    if found.status is not Status.CONVERGED:
        return found, solver.title
    return _polish(judged, error, solver.title, phases)


def _polish(found: SolverResult, error: float, title: str, phases: Phases) -> tuple[SolverResult, str]:
    """Run Newton's method from where an interior-point solver ended; return the better of the two."""
    settings = phases.settings
    most = settings.within(phases.taken).newton_iterations
    newton = polisher(settings.tolerance, settings.control_weight, most)
    polished = phases.run(newton, "polish", found.iterate, should_stop=meets(settings.tolerance))
    if polished.status is Status.CONVERGED or polished.record.residual <= settings.tolerance:
        return _claim_converged(polished), title
    better = polished if polished.record.residual < found.record.residual else found
    if polished.status.is_stopped:
        return replace(better, status=polished.status, advice=polished.advice), title
    advice = (
        f"{title} ends here by its own measure, but the optimality conditions hold to {error:.1e} "
        f"alone, and Newton's method from there {describe_end(polished)}: multipliers may not exist here; "
        'try another guess, or the other of "ipopt" and "fatrop"'
    )
    return replace(better, status=Status.STAGNATED, advice=advice), title


def _claim_converged(result: SolverResult) -> SolverResult:
    advice = f"a local minimum: the optimality conditions hold (residual {result.record.residual:.1e})"
    return replace(result, status=Status.CONVERGED, advice=advice)
