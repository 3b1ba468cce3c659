"""From the name of a method to its phases: one solver, a gradient phase and a Newton phase, or `auto`."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from mbocp.programme.iterate import Iterate
from mbocp.solvers.auto import solve_automatically
from mbocp.solvers.cost_unit import (
    cost_factor,
    in_users_unit,
    settings_in_own_unit,
    start_in_own_unit,
)
from mbocp.solvers.interior import run_interior
from mbocp.solvers.phases import STOPPED, Outcome, Phases, Start, how_it_ended
from mbocp.solvers.protocol import Solver
from mbocp.solvers.records import Status
from mbocp.solvers.registry import INTERIOR_POINT, make_solver
from mbocp.solvers.settings import SolverSettings
from mbocp.solvers.units import in_users_units, start_in

__all__ = ["run_strategy"]

_ROUND_OFF = 1e-6  # residual in the unit of a cost of about 1: more is no round-off
_FINAL = (Status.INTERRUPTED, Status.TIME_LIMIT, Status.INFEASIBLE)  # another unit would not help


def run_strategy(settings: SolverSettings, start: Start) -> Outcome:
    """Solve from one iterate, phase after phase; where the cost turns out tiny, once more in its own unit.

    A programme whose numbers are of ordinary size in other units is counted in these, see `Units`.

    Raises
    ------
    InvalidValue
        If there is no solver of the method's name.
    """
    units = start.programme.units
    if not units.are_users:
        counted = start_in(units, start)
        outcome = run_strategy(replace(settings, control_weight=counted.programme.control_weight), counted)
        return replace(outcome, result=in_users_units(units, outcome.result))
    clock = time.perf_counter()
    outcome = _run_phases(settings, start)
    factor = cost_factor(outcome.result.record.cost)
    if factor == 1.0 or outcome.result.status in _FINAL:
        return outcome
    if settings.time_limit is not None:
        elapsed = time.perf_counter() - clock
        settings = replace(settings, time_limit=max(0.0, settings.time_limit - elapsed))
    after = replace(start, first=start.first + outcome.iterations)
    again = _run_phases(settings_in_own_unit(settings, factor), start_in_own_unit(after, factor))
    result = in_users_unit(again.result, factor)
    is_gain = outcome.result.status is not Status.CONVERGED or result.status is Status.CONVERGED
    is_wrong = result.record.residual > _ROUND_OFF  # then the first was converged by its size alone
    better = result if is_gain or is_wrong else outcome.result
    history = outcome.result.history + result.history
    return replace(again, result=replace(better, history=history), phases=outcome.phases + again.phases)


def _run_phases(settings: SolverSettings, start: Start) -> Outcome:
    phases, method = Phases(start, settings.time_limit), settings.options.method
    if method in INTERIOR_POINT:
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
