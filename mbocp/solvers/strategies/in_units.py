r"""A programme counted in units of its own, solved there, and its result counted as the user does.

`mbocp.programme.stagewise` says which units there are and why they lose nothing. Units of a programme that is
counted in others already are relative to those.

Tiny costs are weighed in a unit of their own. Tolerances are absolute. A machine of a gram and a millimetre
that is asked for :math:`\int u^2/2` has a cost of 1e-12, whose gradient is below any tolerance before the
first iteration. All weights of the cost times one number are the same problem, with multipliers that are as
much larger. So where a solve ends with a tiny cost, the problem is solved once more with its cost multiplied
until it is about 1. Other problems are solved as they are. So are those whose least cost is zero, such as the
effort of a motion that goes on by itself: what is left of it is the square of round-off, and no unit makes
more of that.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, BoolArray, frozen_array
from mbocp.programme import BoundMultipliers, Iterate, StagewiseProgramme
from mbocp.programme.stagewise import Units
from mbocp.solvers.options import SolverSettings
from mbocp.solvers.records import IterationRecord, Status
from mbocp.solvers.strategies.iterating import SolverResult
from mbocp.solvers.strategies.phases import Outcome, Start

Run = Callable[[SolverSettings, Start], Outcome]

_MIN_COST = 1e-5  # cost: ten thousand tolerances of the default
_ZERO = 1e-20  # cost: the square of controls of 1e-10, in units in which ordinary ones are about 1
_ROUND_OFF = 1e-6  # residual in the unit of a cost of about 1: more is no round-off
_FINAL = (Status.INTERRUPTED, Status.TIME_LIMIT, Status.INFEASIBLE)  # another unit would not help


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
    return replace(outcome, result=_count_back(units, outcome.result, told))


def count_in(units: Units, programme: StagewiseProgramme) -> StagewiseProgramme:
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
    return replace(
        start,
        programme=count_in(units, start.programme),
        iterate=iterate_in(units, start.iterate),
        callback=None if callback is None else lambda record: callback(_count_record(units, record)),
        label=label + start.label,
        before=None if start.before is None else _count_result(units, start.before),
    )


def _count_back(units: Units, result: SolverResult, told: str) -> SolverResult:
    inverse = replace(units, force=1.0 / units.force, cost=1.0 / units.cost)
    advice = f"{result.advice}; {told}, and residuals are those of that"
    return replace(_count_result(inverse, result), advice=advice)


def _count_result(units: Units, result: SolverResult) -> SolverResult:
    """A result of a programme as one of the programme counted in `units`."""
    inverse = replace(units, force=1.0 / units.force, cost=1.0 / units.cost)
    return replace(
        result,
        iterate=iterate_in(units, result.iterate),
        record=_count_record(inverse, result.record),
        history=tuple(_count_record(inverse, record) for record in result.history),
    )


def _count_record(units: Units, record: IterationRecord) -> IterationRecord:
    return replace(record, cost=record.cost / units.cost)


def _where(mask: BoolArray, force: float) -> Array:
    return np.where(mask, force, 1.0)


def is_no_cost(cost: float) -> bool:
    """Whether a cost is zero to round-off."""
    return abs(cost) <= _ZERO


def cost_factor(cost: float) -> float:
    """What to multiply a cost with: a power of two; 1 unless it is tiny but no zero."""
    if not _ZERO < abs(cost) < _MIN_COST:  # NaN, too
        return 1.0
    return float(2.0 ** min(-math.floor(math.log2(abs(cost))), 1000))


def run_with_tiny_costs(run: Run, settings: SolverSettings, start: Start) -> Outcome:
    """Solve, and where the cost turns out tiny, once more in a unit of its own."""
    clock = time.perf_counter()
    outcome = run(settings, start)
    factor = cost_factor(outcome.result.record.cost)
    goes_on = settings.is_newton_alone and outcome.result.status is not Status.CONVERGED
    if factor == 1.0 or outcome.result.status in _FINAL or goes_on:
        return outcome
    if settings.time_limit is not None:
        elapsed = time.perf_counter() - clock
        settings = replace(settings, time_limit=max(0.0, settings.time_limit - elapsed))
    again = run_in(
        replace(start.programme.units, cost=factor),
        run,
        settings,
        replace(start, first=start.first + outcome.iterations, before=None),
        told=f"the cost is so small that it was weighed {factor:.0e} times",
        label=f" (cost times {factor:.0e})",
    )
    result = again.result
    if outcome.result.status is Status.CONVERGED and is_no_cost(result.record.cost):
        return outcome
    is_gain = outcome.result.status is not Status.CONVERGED or result.status is Status.CONVERGED
    is_wrong = result.record.residual > _ROUND_OFF  # then the first was converged by its size alone
    better = result if is_gain or is_wrong else outcome.result
    history = outcome.result.history + result.history
    return replace(again, result=replace(better, history=history), phases=outcome.phases + again.phases)
