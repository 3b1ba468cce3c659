"""A programme counted in units of its own, solved there, and its result counted as the user does.

`mbocp.programme.units` says which units there are and why they lose nothing. Units of a programme that is
counted in others already are relative to those.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, BoolArray, frozen_array
from mbocp.programme import BoundMultipliers, Iterate, StagewiseProgramme
from mbocp.programme.units import Units
from mbocp.solvers.records import IterationRecord
from mbocp.solvers.settings import SolverSettings
from mbocp.solvers.strategies.iterating import SolverResult
from mbocp.solvers.strategies.phases import Outcome, Start

Run = Callable[[SolverSettings, Start], Outcome]


def run_in(
    units: Units, run: Run, settings: SolverSettings, start: Start, told: str, label: str = ""
) -> Outcome:
    """Solve in other units than those of the start, and count the result as the start does.

    Parameters
    ----------
    units : Units
    run : callable
        Solves, with settings for the programme in these units.
    settings : SolverSettings
    start : Start
    told : str
        Added to the advice.
    label : str
        Put behind the phases' names, before that of the start.

    Returns
    -------
    outcome : Outcome
        Iterate and costs are as the start counts them; residuals stay what the solver saw.
    """
    counted = _start_in(units, start, label)
    outcome = run(replace(settings, control_weight=counted.programme.control_weight), counted)
    return replace(outcome, result=_counted_back(units, outcome.result, told))


def counted_in(units: Units, programme: StagewiseProgramme) -> StagewiseProgramme:
    """The programme with forces and cost in other units than its own, and no others to be taken."""
    force, bounds = units.force, programme.bounds
    u = _where(units.u, force)
    theta = np.where(programme.theta_weights, units.cost, 1.0) * programme.theta
    terminal = np.where(programme.terminal_weights, units.cost, 1.0) * programme.rho_terminal
    return replace(
        programme,
        theta=frozen_array(_where(units.theta, force) * theta),
        rho_terminal=frozen_array(terminal / _where(units.terminal, force)),
        x_start=frozen_array(programme.x_start / _where(units.x, force)),
        bounds=replace(bounds, u_lower=bounds.u_lower / u, u_upper=bounds.u_upper / u),
        control_weight=units.cost * (force**2 if units.u.all() else 1.0) * programme.control_weight,
        units=replace(units, force=1.0, cost=1.0),
    )


def iterate_in(units: Units, iterate: Iterate) -> Iterate:
    """An iterate of a programme as one of the programme counted in `units`."""
    force, cost = units.force, units.cost
    x, u = _where(units.x, force), _where(units.u, force)
    bounds = iterate.bounds
    if bounds is not None:
        bounds = BoundMultipliers(
            xs=cost * x * bounds.xs,
            us=cost * u * bounds.us,
            path=cost * bounds.path,
            guard=cost * bounds.guard,
        )
    return replace(
        iterate,
        xs=iterate.xs / x,
        ys=iterate.ys / _where(units.y, force),
        us=iterate.us / u,
        ms=cost * _where(units.rows, force) * iterate.ms,
        eta=cost * _where(units.end_rows, force) * iterate.eta,
        bounds=bounds,
    )


def _start_in(units: Units, start: Start, label: str) -> Start:
    """The same start in other units; its callback sees costs as before."""
    callback = start.callback
    return Start(
        counted_in(units, start.programme),
        iterate_in(units, start.iterate),
        None if callback is None else lambda record: callback(_counted_record(units, record)),
        start.first,
        label + start.label,
    )


def _counted_back(units: Units, result: SolverResult, told: str) -> SolverResult:
    inverse = replace(units, force=1.0 / units.force, cost=1.0 / units.cost)
    return replace(
        result,
        advice=f"{result.advice}; {told}, and residuals are those of that",
        iterate=iterate_in(inverse, result.iterate),
        record=_counted_record(units, result.record),
        history=tuple(_counted_record(units, record) for record in result.history),
    )


def _counted_record(units: Units, record: IterationRecord) -> IterationRecord:
    return replace(record, cost=record.cost / units.cost)


def _where(mask: BoolArray, force: float) -> Array:
    return np.where(mask, force, 1.0)
