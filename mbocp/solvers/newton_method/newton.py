"""What the Newton solvers share: their state, its start, its progress and its end.

The parts of a step are the kernel's (`newton_step.hpp`, `filter.hpp`): a receding horizon takes them, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from mbocp.programme import StageKind, StagewiseProgramme
from mbocp.programme.iterate import Iterate
from mbocp.programme.kernel import kernel_programme
from mbocp.programme.native import kernel
from mbocp.solvers.newton_method.centring import Centring
from mbocp.solvers.newton_method.round_off import relative_increment, relative_residual, round_off
from mbocp.solvers.records import Status
from mbocp.solvers.staggered.sweep import Kept, Sweeps

if TYPE_CHECKING:
    from mbocp.programme.native import Evaluation, Factorisation, KernelFilter, KernelProgramme


@dataclass(frozen=True)
class Reference:
    """Where a run of relaxed steps began, to go back to when it leads nowhere.

    Attributes
    ----------
    iterate : Kept
    evaluation : kernel Evaluation
    steps_left : int
        Relaxed steps that may still be taken.
    """

    iterate: Kept
    evaluation: Evaluation
    steps_left: int

    @classmethod
    def of(cls, state: NewtonState, steps: int) -> Reference:
        """Remember the state's iterate."""
        return cls(Kept.of(state.native), state.evaluation, steps)


class NewtonState(NamedTuple):
    """Where Newton's method stands: a tuple, since a changed one is made in each iteration.

    Attributes
    ----------
    native : kernel programme
        Holds the iterate.
    evaluation : kernel Evaluation
        Residuals and cost at the iterate.
    filter : Filter
        Of the line search.
    iteration : int
        Newton steps taken.
    increment, step_length, regularisation : float
        Of the last step.
    augmentation : float
        Weight rho of the end condition inside the factorisation; changes no solution, only its conditioning.
    shift : float
        Where the search for an admissible shift of the state Hessian begins; 0: the plain Hessian.
    last_shift : float
        The last one that a step was taken with.
    reference : Reference or None
        Where a run of relaxed steps began, while one is under way.
    patience : int
        Steps until another such run may begin.
    at_minimum : bool
        Whether the last KKT matrix had a minimum's inertia without any shift.
    contraction : float
        Of the residual, by the last step; infinite if that was no full step.
    still : int
        Steps in a row, without a shift, that halved neither residual nor increment.
    restarts : int
        How often the multipliers have been started anew.
    kind : StageKind or None
        Of the stages.
    barrier : float
        Parameter mu of the limits' barrier; 0: there are no limits.
    least_barrier : float
        Below which round-off makes the system singular, as far as that has been found.
    barrier_since : int
        Iteration with which mu fell last.
    centring : Centring or None
        How steps choose mu; None: it falls by a rule, and the first limit in the way cuts a step.
    failure : Status or None
        Why no step could be taken.
    failed_stage : int
        Where, for a singular system; num_steps: the end condition.
    sweeps : Sweeps or None
        How a staggered solver sweeps.
    """

    native: KernelProgramme
    evaluation: Evaluation
    filter: KernelFilter
    iteration: int = 0
    increment: float = math.inf
    step_length: float = math.nan
    regularisation: float = 0.0
    augmentation: float = 0.0
    shift: float = 0.0
    last_shift: float = 0.0
    reference: Reference | None = None
    patience: int = 0
    at_minimum: bool = False
    contraction: float = math.inf
    still: int = 0
    restarts: int = 0
    kind: StageKind | None = None
    barrier: float = 0.0
    least_barrier: float = 0.0
    barrier_since: int = 0
    centring: Centring | None = None
    failure: Status | None = None
    failed_stage: int = -1
    sweeps: Sweeps | None = None

    @property
    def may_stop(self) -> bool:
        """Whether slacks stop at their bounds, each by itself, rather than that a step is cut."""
        return self.centring is not None

    @property
    def is_free(self) -> bool:
        """Whether the next step chooses mu."""
        return self.centring is not None and self.centring.is_free and self.reference is None

    @property
    def next_increment(self) -> float:
        """What the next one will be, as a Newton step leaves the matrix nearly as it is; or infinite."""
        is_newtons = self.regularisation == 0.0 and self.barrier == 0.0
        return self.increment * self.contraction if is_newtons else math.inf


def start(programme: StagewiseProgramme, iterate: Iterate, threads: int = 1) -> NewtonState:
    """State at an iterate, with its functions and derivatives evaluated; so many threads share the stages."""
    iterate.check(programme)
    native = kernel_programme(programme, threads=threads)
    iterate.load_into(native)
    return new_state(programme, native, native.evaluate())


def new_state(programme: StagewiseProgramme, native: KernelProgramme, evaluation: Evaluation) -> NewtonState:
    """State at the iterate that the kernel programme holds."""
    weight = programme.control_weight / programme.dt
    return NewtonState(
        native,
        evaluation,
        first_filter(evaluation),
        augmentation=10.0 * weight if programme.ng else 0.0,
        kind=programme.kind,
        failure=None if evaluation.finite else Status.DIVERGED,
    )


def first_filter(evaluation: Evaluation) -> KernelFilter:
    """Filter for a first iterate."""
    return kernel().Filter.start(evaluation.violation)


def factorise(state: NewtonState, shift: float = 0.0) -> Factorisation:
    """Factorisation with the end condition augmented as far as its conditioning asks for.

    `shift` is added to the Hessian's diagonal in the states.
    """
    return state.native.factorise_well(shift, state.augmentation)


def next_state(
    state: NewtonState, evaluation: Evaluation, increment: float, step_length: float, **changes: Any
) -> NewtonState:
    """State after a step."""
    before = state.evaluation.residual
    return state._replace(
        contraction=evaluation.residual / before if step_length == 1.0 and before > 0.0 else math.inf,
        evaluation=evaluation,
        iteration=state.iteration + 1,
        increment=increment,
        step_length=step_length,
        failure=None if evaluation.finite else Status.DIVERGED,
        **changes,
    )


def is_resolved(state: NewtonState, tolerance: float, allowed: tuple[float, float] | None = None) -> bool:
    """Whether round-off is above the tolerance, and residual and increment are no more than that allows.

    `allowed`: what round-off may leave of the residual's parts; None: as the unknowns' sizes have it.
    """
    native = state.native
    allowed = allowed or round_off(native)
    return (
        math.isfinite(state.increment)
        and max(allowed) > tolerance
        and relative_residual(allowed, state.evaluation, tolerance) <= tolerance
        and relative_increment(native) <= tolerance
    )


def check_termination(state: NewtonState, tolerance: float, max_iterations: int) -> Status | None:
    """Converged when residual and increment are both below the tolerance, as in section 5.1."""
    if state.failure is not None:
        return state.failure
    if state.evaluation.residual <= tolerance and state.increment <= tolerance:
        return Status.CONVERGED
    return Status.MAX_ITERATIONS if state.iteration >= max_iterations else None
