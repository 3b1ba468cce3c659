"""Monolithic Newton: all optimality conditions of all steps as one system, section 5.1 of [Bijalwan2025]_.

`PureNewton` is the paper's iteration, eq. (23). `GlobalisedNewton` takes the same steps near a minimum, and
makes sure that it gets there: it corrects the inertia, searches along each step with a filter, and keeps
limits by a barrier. It is the kernel's, whose `newton.hpp` says what its rules are, and why.

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
from functools import cached_property
from typing import TYPE_CHECKING

from mbocp._arrays import dataclass
from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import Iterate
from mbocp.programme.native_modules import kernel
from mbocp.solvers.newton_method.limit_multipliers import (
    begin,
    explain_limits_not_kept,
    largest_product,
    resume,
)
from mbocp.solvers.newton_method.newton import (
    PlainState,
    check_termination,
    factorise,
    first_augmentation,
    next_state,
    start,
)
from mbocp.solvers.options import SOLVER_TOLERANCE
from mbocp.solvers.records import IterationRecord, Status
from mbocp.solvers.strategies.iterating import SolverResult, StopTest

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelNewton, KernelNewtonState, KernelProgramme


@dataclass(frozen=True)
class PureNewton:
    """Newton's method without safeguards, eq. (23): it may go to any stationary point, or nowhere.

    Attributes
    ----------
    tolerance : float
        Of the residual and of the increment, both Euclidean norms.
    max_iterations : int
        Newton steps before it gives up.
    threads : int
        Share the work on the stages.
    """

    tolerance: float = SOLVER_TOLERANCE
    max_iterations: int = 200
    name: str = "monolithic (pure Newton)"
    threads: int = 1

    def init(self, programme: StagewiseProgramme, iterate: Iterate) -> PlainState:
        """State at an iterate."""
        return start(programme, iterate, self.threads)

    def step(self, state: PlainState) -> PlainState:
        """Eq. (23)."""
        native = state.native
        factorisation = factorise(state)
        if not factorisation.ok:
            return state._replace(failure=Status.SINGULAR, failed_stage=factorisation.bad_stage)
        direction = native.solve()
        if not direction.finite:
            return state._replace(failure=Status.DIVERGED)
        native.move(1.0)
        native.accept(1.0)
        return next_state(
            state,
            native.evaluate(),
            direction.increment,
            step_length=1.0,
            augmentation=factorisation.augmentation,
            at_minimum=factorisation.negative == native.num_end_conditions,
        )

    def terminate(self, state: PlainState) -> Status | None:
        """Residual and increment both below the tolerance, or below what round-off allows."""
        native, e = state.native, state.evaluation
        is_there = state.failure is None and native.is_resolved(
            e.primal, e.dual, state.increment, self.tolerance
        )
        if is_there and native.has_a_say(e.dual):
            return Status.CONVERGED
        return check_termination(state, self.tolerance, self.max_iterations)


@dataclass(frozen=True)
class GlobalisedNewton:
    """Newton's method with inertia correction and a filter line search; limits are kept by a barrier.

    Attributes
    ----------
    tolerance : float
        Of the residual and of the increment, both Euclidean norms.
    max_iterations : int
        Newton steps before it gives up.
    control_weight : float
        Unit of the shift: the running cost's weight of one control over one step.
    is_polish : bool
        Whether it begins near a solution, with the last barrier and the iterate's own multipliers.
    is_careful : bool
        Whether it begins where many steps have led along a valley: shifts grow by smaller factors.
    rough : float
        Residual with which it ends, whatever the increment; 0: it is to converge.
    threads : int
        Share the work on the stages.
    """

    tolerance: float = SOLVER_TOLERANCE
    max_iterations: int = 200
    control_weight: float = 1.0
    name: str = "monolithic (Newton, inertia correction, filter line search)"
    is_polish: bool = False
    is_careful: bool = False
    rough: float = 0.0
    threads: int = 1

    def init(self, programme: StagewiseProgramme, iterate: Iterate) -> KernelNewtonState:
        """State at an iterate."""
        if self.is_polish:
            return resume(self._newton, programme, iterate, is_centred=True)
        return begin(self._newton, programme, iterate, self.threads)

    def step(self, state: KernelNewtonState) -> KernelNewtonState:
        """Take a step that the filter accepts, with the smallest shift that allows one; or a relaxed step."""
        return self._newton.step(state)

    def terminate(self, state: KernelNewtonState) -> Status | None:
        """Residual and increment both below the tolerance, or arrived as far as round-off lets it."""
        status = self._newton.status(state)
        return None if status is None else Status(status.name)

    def run(self, native: KernelProgramme, programme: StagewiseProgramme) -> tuple[Status, KernelNewtonState]:
        """Take all steps to the end from the iterate of a kernel programme, and say how that ended."""
        state = self._newton.run(self._newton.begin(native, first_augmentation(programme)))
        status = self.terminate(state)
        assert status is not None  # for the type checker: it has ended
        return status, state

    def judge(self, programme: StagewiseProgramme, iterate: Iterate) -> KernelNewtonState:
        """State at an iterate as it is, whose residual is what it leaves of the optimality conditions."""
        return resume(self._newton, programme, iterate, is_centred=False)

    @cached_property
    def _newton(self) -> KernelNewton:
        return kernel().Newton(
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
            control_weight=self.control_weight,
            is_careful=self.is_careful,
            rough=self.rough,
        )


_STEPS = 30  # Newton steps: from near a solution it takes a few, or does not get there


def can_be_polished(programme: StagewiseProgramme) -> bool:
    """Whether our own Newton's method keeps all limits of the programme."""
    return explain_limits_not_kept(programme) is None


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
