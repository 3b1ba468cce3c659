r"""Monolithic Newton: all optimality conditions of all steps as one system, section 5.1 of [Bijalwan2025]_.

`PureNewton` is the paper's iteration, eq. (23). `GlobalisedNewton` takes the same steps near a minimum, and
makes sure that it gets there:

- *Inertia.* A step leads towards a minimum when the KKT matrix has exactly as many negative eigenvalues as
  constraints. The structured factorisation counts them for nothing. Where they are too many, the Hessian in
  the states is shifted by a growing multiple of the identity.
- *Filter line search.* A step is halved until it improves feasibility or cost without going back to anything
  worse in both. A full step that is refused is given one second-order correction. Where halving does not
  help, the shift grows instead, which bends the step towards one that changes the states least; after a good
  step it shrinks again.
- *Adjoint of the guess.* Where the multipliers start from zero and the first step is short, they are taken
  from a backward sweep along the guess instead, eq. (30), and the step is tried again.
- *Multipliers of the guess.* Where states are curved and multipliers by least squares explain the gradient,
  the first Hessian is taken with them, and not with zero.
- *Cap.* No step turns a joint by more than a radian: what the linearisation says of a link that turns farther
  is not worth following, and often leads to another minimum with more turns. A shift that just makes the
  Hessian definite makes steps of hundreds of radians, of which the cap leaves next to nothing: where that is
  less than a tenth, the shift grows.
- *Relaxed steps.* Linearised constraints bend away quickly (a rod, a rotation), and a full Newton step then
  violates them more than any line search accepts, though the next steps make up for it. Where three larger
  shifts still leave a step of less than a tenth, up to six steps are taken without judging them, and more
  while each halves the residual; if none of them is closer to feasible than the start of the run, the start
  is restored.
- *Restoration.* Where none of this allows a step of a fiftieth, a forward sweep in closed loop makes
  the state equations hold along nearly the same motion.
- *Restart.* Where no shift allows any step, the multipliers begin anew, twice at most: many short steps may
  have spoilt them.
- *Limits* enter by a barrier, see `mbocp.solvers.newton_method.limits`. Everything above is then about the
cost with the
  barrier, with slacks that stop at their bounds or cut the step, and multipliers that stay positive.

On random rest-to-rest motions of arms without a velocity weight, where pure Newton fails, alternatives did
worse: shifting controls instead of states, Gauss-Newton in place of a shift, an l1 merit function instead of
the filter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import Iterate
from mbocp.solvers.newton_method.filter import Filter
from mbocp.solvers.newton_method.first_multipliers import with_adjoint, with_least_squares
from mbocp.solvers.newton_method.limits import (
    aimed,
    fixed,
    init_barrier,
    predicts,
    raised,
    resumed,
    update_barrier,
)
from mbocp.solvers.newton_method.line_search import MAX_TURN, search
from mbocp.solvers.newton_method.newton import (
    Direction,
    NewtonState,
    Reference,
    check_termination,
    factorise,
    next_state,
    start,
)
from mbocp.solvers.newton_method.shift import MAX_SHIFT, bold, careful
from mbocp.solvers.newton_method.stopping import (
    STILL,
    has_arrived,
    is_within_round_off,
    leads_no_farther,
    stillness,
)
from mbocp.solvers.records import Status
from mbocp.solvers.staggered.sweep import Kept, Sweeps
from mbocp.solvers.tolerances import FEASIBLE_VIOLATION, SOLVER_TOLERANCE

if TYPE_CHECKING:
    from mbocp.programme.kernel import Factorisation, KernelCare

_CAREFUL_AFTER = 200  # iterations in a run: most take less, and those that take more follow a valley
_RESTARTS = 2
_MIN_SHIFT = 1e-6  # of the Hessian: a larger one makes many short steps along flat valleys
_FAR = 0.1  # of a step: where the cap leaves less, a larger shift is tried first
_LAST_RESORT_STEP = 1e-9  # the step may become as short as this
_RELAXED_STEP = 0.1  # a step shorter than this is an occasion for relaxed ones
_RELAXED_STEPS = 6  # in a run: about as many as Newton's method takes to make up for a bent constraint
_PROMISING = 0.5  # of the residual: a relaxed step that leaves no more may be followed by another
_PAUSE = 10  # steps after a run that led nowhere, before the next
_RESTORATION = 0.5  # of the violation: what a sweep has to leave at most


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

    def init(self, programme: StagewiseProgramme, iterate: Iterate) -> NewtonState:
        """State at an iterate."""
        return start(programme, iterate, self.threads)

    def step(self, state: NewtonState) -> NewtonState:
        """Eq. (23)."""
        native = state.native
        factorisation, augmentation = factorise(state)
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
            augmentation=augmentation,
            at_minimum=factorisation.negative == native.num_end_conditions,
        )

    def terminate(self, state: NewtonState) -> Status | None:
        """Residual and increment both below the tolerance, or below what round-off allows."""
        status = check_termination(state, self.tolerance, self.max_iterations)
        is_there = state.failure is None and is_within_round_off(state, self.tolerance)
        return Status.CONVERGED if is_there else status


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
        Whether it begins where many steps have led along a valley, see `mbocp.solvers.newton_method.shift`.
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

    def init(self, programme: StagewiseProgramme, iterate: Iterate) -> NewtonState:
        """State at an iterate."""
        if self.is_polish:
            return resumed(programme, iterate, self.tolerance, is_centred=True)
        state = init_barrier(programme, iterate, self.tolerance, self.threads)
        return state if state.barrier else with_least_squares(state, self.control_weight)

    def step(self, state: NewtonState) -> NewtonState:
        """One accepted step, with the smallest shift found that allows one; or a relaxed step."""
        if state.barrier:
            state = update_barrier(state, self.tolerance)
        if state.reference is not None:
            return self._relaxed(state)
        if state.least_barrier and state.shift:
            state = self._sharpened(state)
        shift, attempts, care = state.shift, 0, self._care(state)
        while True:
            state, factorisation, augmentation, direction = self._direction(state, shift)
            if not (factorisation.ok or shift):
                state = raised(state, self.tolerance)  # slacks follow with a step, and one may be enough
            is_indefinite = direction is None
            if direction is not None and shift and direction.cap < _FAR and attempts <= care.patience:
                direction = None
            if direction is not None:
                found = search(
                    state, direction, care.min_step if attempts < care.patience else _LAST_RESORT_STEP
                )
                is_short = found is None or direction.relative(found[0]) < _RELAXED_STEP
                if is_short and predicts(state, self.tolerance):
                    return self.step(fixed(state, self.tolerance))
                swept = with_adjoint(state) if is_short else None
                if swept is not None:
                    return self.step(swept)
                is_stuck = is_short and attempts >= care.patience
                if is_stuck and state.patience == 0 and state.evaluation.violation > FEASIBLE_VIOLATION:
                    return self._relaxed(
                        state._replace(reference=Reference.of(state, _RELAXED_STEPS), shift=shift)
                    )
                if is_stuck:
                    restored = self._restored(state, shift)
                    if restored is not None:
                        return restored
                if found is not None:
                    break
                if direction.increment <= self.tolerance and state.evaluation.residual <= self.tolerance:
                    return state._replace(increment=direction.increment)  # round-off hides any decrease
                if shift == 0.0 and leads_no_farther(state, direction.increment, self.tolerance):
                    return state._replace(increment=direction.increment, still=STILL)
            attempts += 1
            if is_indefinite:
                shift = care.regrown_shift(shift, state.last_shift, _MIN_SHIFT)
            else:
                shift = care.larger_shift(shift, _MIN_SHIFT)
            if shift > MAX_SHIFT and state.is_free:
                return self.step(fixed(state, self.tolerance))
            if shift > MAX_SHIFT:
                failure = Status.SINGULAR if direction is None else Status.LINE_SEARCH_FAILED
                if direction is not None and state.restarts < _RESTARTS:
                    return self.step(self._restarted(state))
                return state._replace(failure=failure, failed_stage=factorisation.bad_stage)
        length, by_cost = found
        state.native.accept(length * direction.longest, direction.longest_dual)
        evaluation = state.native.evaluate()
        return next_state(
            state,
            evaluation,
            direction.increment,
            length * direction.longest,
            augmentation=augmentation,
            regularisation=shift,
            last_shift=shift or state.last_shift,
            shift=care.next_shift(
                shift,
                direction.relative(length) * (direction.cap if shift else 1.0),
                evaluation.residual / state.evaluation.residual,
                _MIN_SHIFT,
            ),
            filter=state.filter if by_cost else state.filter.grown(state.evaluation),
            patience=max(0, state.patience - 1),
            at_minimum=shift == 0.0,
            still=0 if shift else stillness(state, evaluation, direction.increment),
        )

    def terminate(self, state: NewtonState) -> Status | None:
        """Residual and increment both below the tolerance, or arrived as far as round-off lets it."""
        status = check_termination(state, self.tolerance, self.max_iterations)
        is_there = has_arrived(state, self.tolerance) or state.evaluation.residual <= self.rough
        return Status.CONVERGED if is_there and state.failure is None else status

    def _care(self, state: NewtonState) -> KernelCare:
        is_valley = self.is_careful or state.iteration >= _CAREFUL_AFTER
        return careful() if is_valley and not state.barrier else bold()  # limits cut steps whatever the shift

    def _direction(
        self, state: NewtonState, shift: float
    ) -> tuple[NewtonState, Factorisation, float, Direction | None]:
        """State with the barrier of the direction, factorisation, augmentation and direction.

        No direction where the inertia is not a minimum's.
        """
        native, is_aimed = state.native, predicts(state, self.tolerance)
        if is_aimed:
            native.aim(0.0)
        factorisation, augmentation = factorise(state, shift * self.control_weight)
        if not (factorisation.ok and factorisation.negative == native.num_end_conditions):
            if is_aimed:
                native.aim(state.barrier)
            return state, factorisation, augmentation, None
        state, found = aimed(state, self.tolerance) if is_aimed else (state, native.solve())
        direction = Direction.of(found, MAX_TURN, may_stop=state.may_stop) if found.finite else None
        return state, factorisation, augmentation, direction

    def _sharpened(self, state: NewtonState) -> NewtonState:
        """State with a barrier that rises while the system is singular without a shift; or with no shift."""
        _, factorisation, _, direction = self._direction(state, 0.0)
        if not factorisation.ok:
            return raised(state, self.tolerance)
        return state if direction is None else state._replace(shift=0.0)

    def _restarted(self, state: NewtonState) -> NewtonState:
        """The same motion with multipliers that know nothing of the way there."""
        native = state.native
        native.m, native.eta = np.zeros_like(native.m), np.zeros_like(native.eta)
        if native.slack.size:
            native.start_limits(state.barrier)
        evaluation = native.evaluate()
        return state._replace(
            evaluation=evaluation,
            shift=0.0,
            filter=Filter.start(evaluation.violation),
            restarts=state.restarts + 1,
        )

    def _restored(self, state: NewtonState, shift: float) -> NewtonState | None:
        """Feasibility by a sweep along the iterate; None with the iterate back if that is no gain.

        What remains of the violation is the end condition's.
        """
        if state.evaluation.violation <= FEASIBLE_VIOLATION:
            return None
        native, kept = state.native, Kept.of(state.native)
        swept = Sweeps(feedback=True).run(native).evaluation
        if swept is not None and swept.violation < _RESTORATION * state.evaluation.violation:
            evaluation = native.evaluate()
            if state.filter.accepts_after_relaxation(state.evaluation, evaluation):
                return next_state(
                    state,
                    evaluation,
                    math.inf,
                    0.0,
                    regularisation=shift,
                    shift=0.0,
                    filter=state.filter.grown(state.evaluation),
                    patience=_PAUSE,
                )
        kept.restore(native)
        native.evaluate()
        self._direction(state, shift)
        return None

    def _relaxed(self, state: NewtonState) -> NewtonState:
        """One full step that nobody judges; the run of them ends with progress, or where it began."""
        reference, native, shift = state.reference, state.native, state.shift
        assert reference is not None  # for the type checker: `step` comes here only with one
        _, _, augmentation, direction = self._direction(state, shift)
        while direction is None and shift <= MAX_SHIFT:
            shift = bold().larger_shift(shift, _MIN_SHIFT)
            _, _, augmentation, direction = self._direction(state, shift)
        if direction is not None:
            native.move(direction.longest)
            native.accept(direction.longest, direction.longest_dual)
            evaluation = native.evaluate()
            promising = evaluation.residual < _PROMISING * state.evaluation.residual
            after = next_state(
                state,
                evaluation,
                direction.increment,
                direction.longest,
                augmentation=augmentation,
                regularisation=shift,
                shift=bold().next_shift(
                    shift, 1.0, evaluation.residual / state.evaluation.residual, _MIN_SHIFT
                ),
                reference=replace(reference, steps_left=max(reference.steps_left - 1, 1 if promising else 0)),
                at_minimum=shift == 0.0,
            )
            if state.filter.accepts_after_relaxation(reference.evaluation, after.evaluation):
                return after._replace(reference=None, filter=state.filter.grown(reference.evaluation))
            if after.failure is None and after.reference is not None and after.reference.steps_left:
                return after
        reference.iterate.restore(native)
        return state._replace(
            evaluation=native.evaluate(),
            iteration=state.iteration + 1,
            increment=math.inf,
            step_length=0.0,
            reference=None,
            patience=_PAUSE,
        )
