r"""Tiny costs, weighed in a unit of their own.

Tolerances are absolute. A machine of a gram and a millimetre that is asked for :math:`\int u^2/2` has a cost
of 1e-12, whose gradient is below any tolerance before the first iteration. All weights of the cost times one
number are the same problem, with multipliers that are as much larger. So where a solve ends with a tiny cost,
the problem is solved once more with its cost multiplied until it is about 1, and multipliers and costs are
divided again in the end. Other problems are solved as they are.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mbocp._arrays import frozen_array
from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import BoundMultipliers, Iterate
from mbocp.solvers.phases import Start
from mbocp.solvers.records import IterationRecord
from mbocp.solvers.run import SolverResult
from mbocp.solvers.settings import SolverSettings

__all__ = [
    "cost_factor",
    "in_own_unit",
    "in_users_unit",
    "record_in_users_unit",
    "settings_in_own_unit",
    "start_in_own_unit",
    "weighed",
]

_MIN_COST = 1e-5  # cost: ten thousand tolerances of the default


def cost_factor(cost: float) -> float:
    """What to multiply a cost with: a power of two, exact in both directions; 1 unless it is tiny."""
    if not 0.0 < abs(cost) < _MIN_COST:  # NaN, too
        return 1.0
    return float(2.0 ** min(-math.floor(math.log2(abs(cost))), 1000))


def weighed(programme: StagewiseProgramme, factor: float) -> StagewiseProgramme:
    """The programme with its cost multiplied."""
    return replace(
        programme,
        theta=frozen_array(np.where(programme.theta_weights, factor, 1.0) * programme.theta),
        rho_terminal=frozen_array(np.where(programme.terminal_weights, factor, 1.0) * programme.rho_terminal),
        control_weight=factor * programme.control_weight,
    )


def settings_in_own_unit(settings: SolverSettings, factor: float) -> SolverSettings:
    """Settings for the multiplied cost."""
    return replace(settings, control_weight=factor * settings.control_weight)


def start_in_own_unit(start: Start, factor: float) -> Start:
    """Start with the cost multiplied; what the callback sees is as the user weighed it."""
    callback = start.callback

    def told(record: IterationRecord) -> object:
        return callback(record_in_users_unit(record, factor)) if callback is not None else None

    return Start(
        weighed(start.programme, factor),
        in_own_unit(start.iterate, factor),
        told,
        start.first,
        f" (cost times {factor:.0e}){start.label}",
    )


def in_own_unit(iterate: Iterate, factor: float) -> Iterate:
    """The iterate with multipliers that belong to the multiplied cost."""
    bounds = iterate.bounds
    if bounds is not None:
        parts = (bounds.xs, bounds.us, bounds.path, bounds.guard)
        bounds = BoundMultipliers(*(factor * part for part in parts))
    return replace(iterate, ms=factor * iterate.ms, eta=factor * iterate.eta, bounds=bounds)


def in_users_unit(result: SolverResult, factor: float) -> SolverResult:
    """A result with multipliers and costs as the user weighed them; residuals stay what the solver saw."""
    told = f"; the cost is so small that it was weighed {factor:.0e} times, and residuals are those of that"
    return replace(
        result,
        advice=result.advice + told,
        iterate=in_own_unit(result.iterate, 1.0 / factor),
        record=record_in_users_unit(result.record, factor),
        history=tuple(record_in_users_unit(record, factor) for record in result.history),
    )


def record_in_users_unit(record: IterationRecord, factor: float) -> IterationRecord:
    """A record with the cost as the user weighed it."""
    return replace(record, cost=record.cost / factor)
