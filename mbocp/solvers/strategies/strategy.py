"""From the name of a method to an outcome: the choice of a strategy, and the plain ones.

A strategy is a function of `Phases`, and runs solvers through that account.
"""

from __future__ import annotations

import math
from dataclasses import replace

from mbocp.programme.stagewise import Units
from mbocp.solvers.options import SolverSettings
from mbocp.solvers.records import Status
from mbocp.solvers.strategies.auto import run_auto
from mbocp.solvers.strategies.elsewhere import Tell
from mbocp.solvers.strategies.in_units import run_in, run_with_tiny_costs
from mbocp.solvers.strategies.phases import Outcome, Phases, Start, describe_end
from mbocp.solvers.strategies.registry import INTERIOR_POINT, make_solver


def run_elsewhere(settings: SolverSettings, start: Start, tell: Tell) -> Outcome:
    """Solve in another process, and tell nothing on the way."""
    return run_strategy(settings, start)


def run_strategy(settings: SolverSettings, start: Start) -> Outcome:
    """Solve from one iterate, phase after phase; where the cost turns out tiny, once more in its own unit.

    A programme whose numbers are of ordinary size in other units is counted in these, see `Units`.

    Raises
    ------
    InvalidValue
        If there is no solver of the method's name.
    """
    units = start.programme.units
    if units.are_users:
        return run_with_tiny_costs(_run_phases, settings, start)
    return run_in(units, run_strategy, settings, start, told=f"solved with {_words(units)}")


def _run_phases(settings: SolverSettings, start: Start) -> Outcome:
    """Run the phases of a method after each other."""
    phases, method = Phases(start, settings), settings.options.method
    if method in INTERIOR_POINT:
        from mbocp.solvers.strategies.interior import run_interior

        return phases.outcome(*run_interior(method, phases))
    if method == "auto" and settings.has_inequalities:
        from mbocp.solvers.strategies.within_limits import run_auto_within_limits

        return run_auto_within_limits(phases)
    if method == "auto":
        return run_auto(phases)
    first, _, then = method.partition("+")
    return _run_hybrid(first, then, phases) if then else _run_alone(first, phases)


def _run_alone(name: str, phases: Phases) -> Outcome:
    """Run one solver from the guess to its end."""
    solver = make_solver(name, phases.settings)
    return phases.outcome(phases.run(solver, name, phases.guess), solver.name)


def _run_hybrid(first: str, then: str, phases: Phases) -> Outcome:
    """Run gradient steps, then Newton's method from where they came to, section 5.3."""
    gradient = make_solver(first, phases.settings, phases.settings.switch)
    newton = make_solver(then, phases.settings)
    solver = f"{gradient.name}, then {newton.name}"
    begun = phases.run(gradient, first, phases.guess)
    if begun.status.is_stopped:
        return phases.outcome(begun, solver)
    is_done = begun.status in (Status.SWITCHED, Status.CONVERGED)
    words = "" if is_done else f"{first} {describe_end(begun)}"
    start = phases.guess if begun.status is Status.SWEEP_FAILED else begun.iterate
    found = phases.run(newton, then, start)
    if not math.isfinite(found.record.cost + found.record.residual):
        # Newton's method left the numbers at once, or it would have kept a better iterate.
        found = replace(found, iterate=begun.iterate, record=begun.record)
    return phases.outcome(found, solver, words)


def _words(units: Units) -> str:
    words = [f"cost weighed {units.cost:.0e} times"]
    if units.force != 1.0:
        words = [f"forces counted in {units.force:.0e} N or N m", *words]
    return " and ".join(words)
