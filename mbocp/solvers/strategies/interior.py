"""IPOPT or fatrop as a phase: its claim is judged by our own measure, and polished by Newton's method."""

from __future__ import annotations

from dataclasses import replace

from mbocp.programme.iterate import Iterate
from mbocp.solvers.newton_method.polish import Judged, can_be_polished, meets, polisher
from mbocp.solvers.nlp.interior_point import InteriorPoint
from mbocp.solvers.records import Status
from mbocp.solvers.settings import SolverSettings
from mbocp.solvers.strategies.iterating import SolverResult
from mbocp.solvers.strategies.phases import STOPPED, Phases, how_it_ended

_SETTLED = (Status.CONVERGED, Status.LINE_SEARCH_FAILED)  # ends of an interior-point solver at a solution


def run_interior(
    settings: SolverSettings, name: str, iterate: Iterate, phases: Phases
) -> tuple[SolverResult, str]:
    """IPOPT or fatrop, and Newton's method where its end does not hold by our own measure; and a title."""
    solver = InteriorPoint(
        name,
        settings.tolerance,
        settings.interior_iterations(phases.taken),
        phases.time_left,
        settings.options.linear_solver,
    )
    found = phases.run_interior(solver, name, iterate)
    if found.status not in _SETTLED or not can_be_polished(phases.programme):
        return found, solver.title
    judged = Judged.of(found, phases.programme, settings.tolerance)
    if judged.error <= settings.tolerance:
        return _converged(judged.result), solver.title
    if found.status is not Status.CONVERGED:
        return found, solver.title
    return _polished(settings, judged, solver.title, phases)


def _polished(
    settings: SolverSettings, judged: Judged, title: str, phases: Phases
) -> tuple[SolverResult, str]:
    """Newton's method from where an interior-point solver ended; the better of the two."""
    found, most = judged.result, settings.within(phases.taken).newton_iterations
    newton = polisher(settings.tolerance, settings.control_weight, most)
    polished = phases.run(newton, "polish", found.iterate, should_stop=meets(settings.tolerance))
    if polished.status is Status.CONVERGED or polished.record.residual <= settings.tolerance:
        return _converged(polished), title
    better = polished if polished.record.residual < found.record.residual else found
    if polished.status in STOPPED:
        return replace(better, status=polished.status, advice=polished.advice), title
    advice = (
        f"{title} ends here by its own measure, but the optimality conditions hold to {judged.error:.1e} "
        f"alone, and Newton's method from there {how_it_ended(polished)}: multipliers may not exist here; "
        'try another guess, or the other of "ipopt" and "fatrop"'
    )
    return replace(better, status=Status.STAGNATED, advice=advice), title


def _converged(result: SolverResult) -> SolverResult:
    advice = f"a local minimum: the optimality conditions hold (residual {result.record.residual:.1e})"
    return replace(result, status=Status.CONVERGED, advice=advice)
