"""A programme counted in units of its own, solved there, and its result counted as the user does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, BoolArray, frozen_array
from mbocp.programme import BoundMultipliers, Iterate, StagewiseProgramme
from mbocp.programme.units import Units
from mbocp.solvers.phases import Start
from mbocp.solvers.records import IterationRecord
from mbocp.solvers.run import SolverResult

__all__ = ["counted_in", "in_users_units", "iterate_in", "start_in"]


def counted_in(units: Units, programme: StagewiseProgramme) -> StagewiseProgramme:
    """The programme with forces and cost in other units than the user's, and no others to be taken."""
    force, bounds = units.force, programme.bounds
    u = _where(units.u, force)
    theta = np.where(programme.theta_weights, units.cost, 1.0) * programme.theta
    terminal = np.where(programme.terminal_weights, units.cost, 1.0) * programme.rho_terminal
    return replace(
        programme,
        theta=frozen_array(np.where(units.theta, force, theta)),
        rho_terminal=frozen_array(terminal / _where(units.terminal, force)),
        x_start=frozen_array(programme.x_start / _where(units.x, force)),
        bounds=replace(bounds, u_lower=bounds.u_lower / u, u_upper=bounds.u_upper / u),
        control_weight=units.cost * (force**2 if units.u.all() else 1.0) * programme.control_weight,
        units=replace(units, force=1.0, cost=1.0),
    )


def iterate_in(units: Units, iterate: Iterate) -> Iterate:
    """An iterate of the user's programme as one of the programme counted in `units`."""
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
        ys=iterate.ys / force,
        us=iterate.us / u,
        ms=cost * _where(units.rows, force) * iterate.ms,
        eta=cost * _where(units.end_rows, force) * iterate.eta,
        bounds=bounds,
    )


def start_in(units: Units, start: Start) -> Start:
    """The same start in other units; its callback sees costs as the user counts them."""
    callback = start.callback
    return Start(
        counted_in(units, start.programme),
        iterate_in(units, start.iterate),
        None if callback is None else lambda record: callback(_record(units, record)),
        start.first,
        start.label,
    )


def in_users_units(units: Units, result: SolverResult) -> SolverResult:
    """A result with iterate and costs as the user counts them; residuals stay what the solver saw."""
    inverse = replace(units, force=1.0 / units.force, cost=1.0 / units.cost)
    return replace(
        result,
        advice=f"{result.advice}; {_words(units)}",
        iterate=iterate_in(inverse, result.iterate),
        record=_record(units, result.record),
        history=tuple(_record(units, record) for record in result.history),
    )


def _record(units: Units, record: IterationRecord) -> IterationRecord:
    return replace(record, cost=record.cost / units.cost)


def _where(mask: BoolArray, force: float) -> Array:
    return np.where(mask, force, 1.0)


def _words(units: Units) -> str:
    words = [f"cost weighed {units.cost:.0e} times"]
    if units.force != 1.0:
        words = [f"forces counted in {units.force:.0e} N or N m", *words]
    return f"solved with {' and '.join(words)}, and residuals are those of that"
