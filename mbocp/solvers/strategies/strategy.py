"""From the name of a method to an outcome: the choice of a strategy, and the plain ones.

A strategy is frozen, has one method, `run(phases)`, and runs solvers through that account.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import Iterate
from mbocp.programme.stagewise import Units
from mbocp.solvers.records import Status
from mbocp.solvers.settings import SolverSettings
from mbocp.solvers.strategies.auto import Auto
from mbocp.solvers.strategies.phases import Outcome, Phases, Start, Strategy, how_it_ended
from mbocp.solvers.strategies.registry import INTERIOR_POINT, make_solver
from mbocp.solvers.strategies.units import run_in, run_with_tiny_costs


@dataclass(frozen=True)
class SolveTask:
    """A solve for another process."""

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


def strategy_for(settings: SolverSettings) -> Strategy:
    """Choose how the phases of a solve follow each other."""
    method = settings.options.method
    if method in INTERIOR_POINT:
        from mbocp.solvers.strategies.interior import InteriorPhase

        return InteriorPhase(method)
    if method == "auto" and settings.has_inequalities:
        from mbocp.solvers.strategies.within_limits import AutoWithinLimits

        return AutoWithinLimits()
    if method == "auto":
        return Auto()
    first, _, then = method.partition("+")
    return Hybrid(first, then) if then else OnePhase(first)


@dataclass(frozen=True)
class OnePhase:
    """One solver, to its end.

    Attributes
    ----------
    name : str
        Of the solver.
    """

    name: str

    def run(self, phases: Phases) -> Outcome:
        """Run it from the guess."""
        solver = make_solver(self.name, phases.settings)
        return phases.outcome(phases.run(solver, self.name, phases.guess), solver.name)


@dataclass(frozen=True)
class Hybrid:
    """Gradient steps, then Newton's method from where they came to, section 5.3.

    Attributes
    ----------
    gradient, newton : str
        Names of the solvers.
    """

    gradient: str
    newton: str

    def run(self, phases: Phases) -> Outcome:
        """Run one after the other."""
        settings = phases.settings
        gradient, newton = (
            make_solver(self.gradient, settings, settings.switch),
            make_solver(self.newton, settings),
        )
        solver = f"{gradient.name}, then {newton.name}"
        begun = phases.run(gradient, self.gradient, phases.guess)
        if begun.status.is_stopped:
            return phases.outcome(begun, solver)
        is_done = begun.status in (Status.SWITCHED, Status.CONVERGED)
        words = "" if is_done else f"{self.gradient} {how_it_ended(begun)}"
        start = phases.guess if begun.status is Status.SWEEP_FAILED else begun.iterate
        found = phases.run(newton, self.newton, start)
        if not math.isfinite(found.record.cost + found.record.residual):
            # Newton's method left the numbers at once, or it would have kept a better iterate.
            found = replace(found, iterate=begun.iterate, record=begun.record)
        return phases.outcome(found, solver, words)


def _run_phases(settings: SolverSettings, start: Start) -> Outcome:
    return strategy_for(settings).run(Phases(start, settings))


def _words(units: Units) -> str:
    words = [f"cost weighed {units.cost:.0e} times"]
    if units.force != 1.0:
        words = [f"forces counted in {units.force:.0e} N or N m", *words]
    return " and ".join(words)
