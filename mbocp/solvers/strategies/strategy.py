"""From the name of a method to its phases: one solver, a gradient phase and a Newton phase, or `auto`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import Iterate
from mbocp.programme.units import Units
from mbocp.solvers.protocol import Solver
from mbocp.solvers.records import Status
from mbocp.solvers.settings import SolverSettings
from mbocp.solvers.strategies.auto import solve_automatically
from mbocp.solvers.strategies.cost_unit import run_with_tiny_costs
from mbocp.solvers.strategies.phases import STOPPED, Outcome, Phases, Start, how_it_ended
from mbocp.solvers.strategies.registry import INTERIOR_POINT, make_solver
from mbocp.solvers.strategies.units import run_in


@dataclass(frozen=True)
class Strategy:
    """A solve as a task for another process."""

    settings: SolverSettings
    programme: StagewiseProgramme
    iterate: Iterate
    label: str

    def run(self, tell: Callable[[object], None]) -> Outcome:
        """Solve, and tell nothing on the way."""
        return run_strategy(self.settings, Start(self.programme, self.iterate, label=self.label))


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


def _words(units: Units) -> str:
    words = [f"cost weighed {units.cost:.0e} times"]
    if units.force != 1.0:
        words = [f"forces counted in {units.force:.0e} N or N m", *words]
    return " and ".join(words)


def _run_phases(settings: SolverSettings, start: Start) -> Outcome:
    phases, method = Phases(start, settings.time_limit), settings.options.method
    if method in INTERIOR_POINT:
        from mbocp.solvers.strategies.interior import run_interior

        return phases.outcome(*run_interior(settings, method, start.iterate, phases))
    if method == "auto":
        return solve_automatically(settings, start.iterate, phases)
    first, *then = method.split("+")
    if not then:
        solver = make_solver(first, settings)
        return phases.outcome(phases.run(solver, first, start.iterate), solver.name)
    gradient, newton = make_solver(first, settings, settings.switch), make_solver("+".join(then), settings)
    return _hybrid(gradient, newton, (first, *then), start.iterate, phases)


def _hybrid(
    gradient: Solver[Any], newton: Solver[Any], names: Sequence[str], iterate: Iterate, phases: Phases
) -> Outcome:
    """Gradient steps, then Newton's method from where they came to, section 5.3."""
    solver = f"{gradient.name}, then {newton.name}"
    begun = phases.run(gradient, names[0], iterate)
    if begun.status in STOPPED:
        return phases.outcome(begun, solver)
    told = "" if begun.status in (Status.SWITCHED, Status.CONVERGED) else f"{names[0]} {how_it_ended(begun)}"
    start = iterate if begun.status is Status.SWEEP_FAILED else begun.iterate
    found = phases.run(newton, names[1], start)
    if not math.isfinite(
        found.record.cost + found.record.residual
    ):  # at once, or it would have kept a better one
        found = replace(found, iterate=begun.iterate, record=begun.record)
    return phases.outcome(found, solver, told)
