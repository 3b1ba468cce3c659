r"""How well a point satisfies the optimality conditions, whoever found it.

An interior-point solver says that it has converged by a measure of its own: IPOPT divides stationarity by the
mean multiplier, fatrop takes its own scales. Where multipliers are large, that may leave much. So its result
counts as converged only where the residual that our own Newton's method goes by meets the tolerance. Where it
does not, Newton's method goes on from there, with the multipliers that were found and the last barrier, and
needs a few steps as a rule.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from mbocp.programme import StagewiseProgramme
from mbocp.programme.native_modules import kernel
from mbocp.solvers.newton_method.limit_multipliers import largest_product, why_limits_cannot_be_kept
from mbocp.solvers.newton_method.monolithic import GlobalisedNewton
from mbocp.solvers.records import IterationRecord
from mbocp.solvers.strategies.iterating import SolverResult, StopTest

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelNewtonState

_STEPS = 30  # Newton steps: from near a solution it takes a few, or does not get there


def can_be_polished(programme: StagewiseProgramme) -> bool:
    """Whether our own Newton's method keeps all limits of the programme."""
    return why_limits_cannot_be_kept(programme) is None


def judge(
    result: SolverResult, programme: StagewiseProgramme, tolerance: float
) -> tuple[SolverResult, float]:
    """Return a result with its residual by the measure of our own Newton's method, and that residual.

    It is that of the iterate with its own multipliers. Where round-off is above the tolerance, the second is
    in units in which that is the tolerance, see the kernel's `stopping.hpp`.
    """
    state = GlobalisedNewton(tolerance).judge(programme, result.iterate)
    native, primal, dual = state.native, state.evaluation.primal, _dual(state, programme)
    residual = math.hypot(primal, dual)
    error = kernel().relative_residual(native.round_off(), primal, dual, tolerance)
    if error <= tolerance < residual and not native.has_a_say(dual):
        error = residual
    record = replace(result.record, residual=residual, primal=primal, dual=dual)
    return replace(result, record=record), error


def _dual(state: KernelNewtonState, programme: StagewiseProgramme) -> float:
    """Norm of the stationarity conditions, and the largest product of a multiplier and its distance.

    An interior-point method leaves the same product at every limit; their Euclidean norm would ask the more
    of it the more limits there are.
    """
    e = state.evaluation
    stationarity = math.sqrt(max(0.0, e.dual**2 - e.complementarity**2))
    return math.hypot(stationarity, largest_product(state.native, programme))


def polisher(tolerance: float, control_weight: float, most: int) -> GlobalisedNewton:
    """Newton's method from a point near a solution, of at most so many steps."""
    return GlobalisedNewton(
        tolerance, min(_STEPS, most), control_weight=control_weight, name="Newton", is_polish=True
    )


def meets(tolerance: float) -> StopTest:
    """End a run as soon as its last residual meets the tolerance: increments need not."""

    def is_there(history: Sequence[IterationRecord]) -> bool:
        return history[-1].residual <= tolerance

    return is_there
