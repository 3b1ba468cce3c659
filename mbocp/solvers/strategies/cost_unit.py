r"""Tiny costs, weighed in a unit of their own.

Tolerances are absolute. A machine of a gram and a millimetre that is asked for :math:`\int u^2/2` has a cost
of 1e-12, whose gradient is below any tolerance before the first iteration. All weights of the cost times one
number are the same problem, with multipliers that are as much larger. So where a solve ends with a tiny cost,
the problem is solved once more with its cost multiplied until it is about 1, see
`mbocp.solvers.strategies.units`. Other problems are solved as they are. So are those whose least cost is
zero, such as the effort of a motion that goes on by itself: what is left of it is the square of round-off,
and no unit makes more of that.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace

from mbocp.solvers.records import Status
from mbocp.solvers.settings import SolverSettings
from mbocp.solvers.strategies.phases import Outcome, Start
from mbocp.solvers.strategies.units import Run, run_in

_MIN_COST = 1e-5  # cost: ten thousand tolerances of the default
_ZERO = 1e-20  # cost: the square of controls of 1e-10, in units in which ordinary ones are about 1
_ROUND_OFF = 1e-6  # residual in the unit of a cost of about 1: more is no round-off
_FINAL = (Status.INTERRUPTED, Status.TIME_LIMIT, Status.INFEASIBLE)  # another unit would not help


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
    if factor == 1.0 or outcome.result.status in _FINAL:
        return outcome
    if settings.time_limit is not None:
        elapsed = time.perf_counter() - clock
        settings = replace(settings, time_limit=max(0.0, settings.time_limit - elapsed))
    again = run_in(
        replace(start.programme.units, cost=factor),
        run,
        settings,
        replace(start, first=start.first + outcome.iterations),
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
