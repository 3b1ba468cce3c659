"""Where Newton's method stands without safeguards, and in sweeps: state, start, progress and end.

`mbocp.solvers.newton_method.monolithic` has the method with safeguards, whose state is the kernel's.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import Iterate
from mbocp.programme.kernel import kernel_programme
from mbocp.programme.native_modules import kernel
from mbocp.solvers.records import Status

if TYPE_CHECKING:
    from mbocp.programme.native_modules import Evaluation, Factorisation, KernelFilter, KernelProgramme
    from mbocp.solvers.staggered.sweep import Sweeps


class PlainState(NamedTuple):
    """A state as a tuple, since a changed one is made in each iteration.

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
    at_minimum : bool
        Whether the last KKT matrix had a minimum's inertia without any shift.
    contraction : float
        Of the residual, by the last step; infinite if that was no full step.
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
    at_minimum: bool = False
    contraction: float = math.inf
    failure: Status | None = None
    failed_stage: int = -1
    sweeps: Sweeps | None = None

    @property
    def next_increment(self) -> float:
        """What the next one will be, as a Newton step leaves the matrix nearly as it is; or infinite."""
        return self.increment * self.contraction if self.regularisation == 0.0 else math.inf


def start(programme: StagewiseProgramme, iterate: Iterate, threads: int = 1) -> PlainState:
    """State at an iterate, with its functions and derivatives evaluated; so many threads share the stages."""
    iterate.check(programme)
    native = kernel_programme(programme, threads=threads)
    iterate.load_into(native)
    return new_state(programme, native, native.evaluate())


def new_state(programme: StagewiseProgramme, native: KernelProgramme, evaluation: Evaluation) -> PlainState:
    """State at the iterate that the kernel programme holds."""
    return PlainState(
        native,
        evaluation,
        kernel().Filter.start(evaluation.violation, is_limited=False),
        augmentation=first_augmentation(programme),
        failure=None if evaluation.finite else Status.DIVERGED,
    )


def first_augmentation(programme: StagewiseProgramme) -> float:
    """Weight of the end condition in the first factorisation."""
    return 10.0 * programme.control_weight / programme.dt if programme.ng else 0.0


def factorise(state: PlainState, shift: float = 0.0) -> Factorisation:
    """Factorisation with the end condition augmented as far as its conditioning asks for.

    `shift` is added to the Hessian's diagonal in the states.
    """
    return state.native.factorise_well(shift, state.augmentation)


def next_state(
    state: PlainState, evaluation: Evaluation, increment: float, step_length: float, **changes: Any
) -> PlainState:
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


def check_termination(state: PlainState, tolerance: float, max_iterations: int) -> Status | None:
    """Converged when residual and increment are both below the tolerance, as in section 5.1."""
    if state.failure is not None:
        return state.failure
    if state.evaluation.residual <= tolerance and state.increment <= tolerance:
        return Status.CONVERGED
    return Status.MAX_ITERATIONS if state.iteration >= max_iterations else None
