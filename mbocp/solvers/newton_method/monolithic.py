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
- *Limits* enter by a barrier, see `mbocp.solvers.newton_method.limits`. Everything above is then about
  the cost with the barrier, with slacks that stop at their bounds or cut the step, and multipliers that stay
  positive.

On random rest-to-rest motions of arms without a velocity weight, where pure Newton fails, alternatives did
worse: shifting controls instead of states, Gauss-Newton in place of a shift, an l1 merit function instead of
the filter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import Iterate
from mbocp.solvers.newton_method.first_multipliers import with_adjoint, with_least_squares
from mbocp.solvers.newton_method.limits import (
    aim_barrier,
    fix_barrier,
    init_barrier,
    predicts,
    raise_barrier,
    resume,
    update_barrier,
)
from mbocp.solvers.newton_method.newton import (
    NewtonState,
    Reference,
    check_termination,
    factorise,
    first_filter,
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
from mbocp.solvers.tolerances import SOLVER_TOLERANCE

if TYPE_CHECKING:
    from mbocp.programme.native import Factorisation, KernelCappedDirection, KernelCare

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

    def terminate(self, state: NewtonState) -> Status | None:
        """Residual and increment both below the tolerance, or below what round-off allows."""
        status = check_termination(state, self.tolerance, self.max_iterations)
        is_there = state.failure is None and is_within_round_off(state, self.tolerance)
        return Status.CONVERGED if is_there else status


class _Again(NamedTuple):
    """A state from which the step begins anew, as no step has been taken."""

    state: NewtonState


class _Tried(NamedTuple):
    """The system with one shift.

    Attributes
    ----------
    state : NewtonState
        With the barrier parameter of the direction.
    shift : float
    factorisation : kernel Factorisation
    direction : kernel CappedDirection, optional
        None where the inertia is not a minimum's, or a larger shift is to be tried first.
    """

    state: NewtonState
    shift: float
    factorisation: Factorisation
    direction: KernelCappedDirection | None

    def is_capped_to(self, part: float) -> bool:
        """Whether the cap on turns leaves less than a part of the step."""
        return self.direction is not None and self.direction.cap < part


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
            return resume(programme, iterate, self.tolerance, is_centred=True)
        state = init_barrier(programme, iterate, self.tolerance, self.threads)
        return state if state.barrier else with_least_squares(state, self.control_weight)

    def step(self, state: NewtonState) -> NewtonState:
        """Take a step that the filter accepts, with the smallest shift that allows one; or a relaxed step.

        Where something else has to change first, the step begins anew: docs/solver.md draws what leads where.
        """
        while True:
            state = self._choose_barrier(state)
            if state.reference is not None:
                return self._relax(state)
            end = self._find_step(state)
            if not isinstance(end, _Again):
                return end
            state = end.state

    def terminate(self, state: NewtonState) -> Status | None:
        """Residual and increment both below the tolerance, or arrived as far as round-off lets it."""
        status = check_termination(state, self.tolerance, self.max_iterations)
        is_there = has_arrived(state, self.tolerance) or state.evaluation.residual <= self.rough
        return Status.CONVERGED if is_there and state.failure is None else status

    def _care(self, state: NewtonState) -> KernelCare:
        is_valley = self.is_careful or state.iteration >= _CAREFUL_AFTER
        return careful() if is_valley and not state.barrier else bold()  # limits cut steps whatever the shift

    def _choose_barrier(self, state: NewtonState) -> NewtonState:
        """Let mu fall where the iterate allows it, or rise where round-off hides the smallest curvature."""
        if state.barrier:
            state = update_barrier(state, self.tolerance)
        has_risen = state.least_barrier > 0.0 and state.shift > 0.0 and state.reference is None
        return self._sharpen(state) if has_risen else state

    def _find_step(self, state: NewtonState) -> NewtonState | _Again:
        """Try one shift after another until one allows a step."""
        shift, attempts, care = state.shift, 0, self._care(state)
        while True:
            tried = self._linearise(state, shift)
            is_indefinite = tried.direction is None
            if not (tried.factorisation.ok or shift):
                # Slacks follow with a step, and one step may be enough to leave what is singular.
                tried = tried._replace(state=raise_barrier(tried.state, self.tolerance))
            if shift and tried.is_capped_to(_FAR) and attempts <= care.patience:
                # Nothing is left of a step of hundreds of radians; a larger shift makes a shorter one.
                tried = tried._replace(direction=None)
            if tried.direction is not None:
                end = self._follow(tried, tried.direction, care, is_last=attempts >= care.patience)
                if end is not None:
                    return end
            state, attempts = tried.state, attempts + 1
            if is_indefinite:
                shift = care.regrown_shift(shift, state.last_shift, _MIN_SHIFT)
            else:
                shift = care.larger_shift(shift, _MIN_SHIFT)
            if shift > MAX_SHIFT:
                return self._give_up(tried)

    def _follow(
        self, tried: _Tried, direction: KernelCappedDirection, care: KernelCare, *, is_last: bool
    ) -> NewtonState | _Again | None:
        """Go along a direction as far as the filter lets it; None: a larger shift may allow more.

        `is_last`: whether larger shifts have been tried in vain.
        """
        state, shortest = tried.state, _LAST_RESORT_STEP if is_last else care.min_step
        found = state.native.search(state.filter, state.evaluation, direction, shortest, state.may_stop)
        if direction.relative(found.length) < _RELAXED_STEP:
            end = self._rescue(tried, is_last=is_last)
            if end is not None:
                return end
        if not found.length:
            return self._arrive(tried, direction)
        return self._accept(tried, direction, care, found.length, found.by_cost)

    def _rescue(self, tried: _Tried, *, is_last: bool) -> NewtonState | _Again | None:
        """Do something about a short step; None: take it, or a larger shift."""
        state = tried.state
        if predicts(state, self.tolerance):  # a barrier that was foreseen is the first to be doubted, ...
            return _Again(fix_barrier(state, self.tolerance))
        swept = with_adjoint(state)  # ... then multipliers that begin at zero
        if swept is not None:
            return _Again(swept)
        if not is_last:
            return None
        # Where equations bend away, no line search goes on: steps that nobody judges may, or a sweep.
        if state.patience == 0 and not state.evaluation.is_feasible:
            reference = Reference.of(state, _RELAXED_STEPS)
            return self._relax(state._replace(reference=reference, shift=tried.shift))
        return self._restore_feasibility(state, tried.shift)

    def _arrive(self, tried: _Tried, direction: KernelCappedDirection) -> NewtonState | None:
        """Return the state as it is where only round-off keeps the filter from accepting a step; or None."""
        state, increment = tried.state, direction.increment
        if increment <= self.tolerance and state.evaluation.residual <= self.tolerance:
            return state._replace(increment=increment)  # round-off hides any decrease
        if tried.shift == 0.0 and leads_no_farther(state, increment, self.tolerance):
            return state._replace(increment=increment, still=STILL)
        return None

    def _accept(
        self, tried: _Tried, direction: KernelCappedDirection, care: KernelCare, length: float, by_cost: bool
    ) -> NewtonState:
        """Take the step that the filter has accepted; `by_cost`: for the cost, which adds no corner to it."""
        state, shift = tried.state, tried.shift
        state.native.accept(length * direction.longest, direction.longest_dual)
        evaluation = state.native.evaluate()
        return next_state(
            state,
            evaluation,
            direction.increment,
            length * direction.longest,
            augmentation=tried.factorisation.augmentation,
            regularisation=shift,
            last_shift=shift or state.last_shift,
            shift=care.next_shift(
                shift,
                direction.relative(length) * (direction.cap if shift else 1.0),
                evaluation.residual / state.evaluation.residual,
                _MIN_SHIFT,
            ),
            filter=state.filter if by_cost else state.filter.with_corner(state.evaluation),
            patience=max(0, state.patience - 1),
            at_minimum=shift == 0.0,
            still=0 if shift else stillness(state, evaluation, direction.increment),
        )

    def _give_up(self, tried: _Tried) -> NewtonState | _Again:
        """Fix the barrier, or begin anew with the multipliers, where no shift allows a step; else fail."""
        state, is_singular = tried.state, tried.direction is None
        if state.is_free:
            return _Again(fix_barrier(state, self.tolerance))
        if not is_singular and state.restarts < _RESTARTS:
            return _Again(self._restart_multipliers(state))
        failure = Status.SINGULAR if is_singular else Status.LINE_SEARCH_FAILED
        return state._replace(failure=failure, failed_stage=tried.factorisation.bad_stage)

    def _linearise(self, state: NewtonState, shift: float) -> _Tried:
        """Direction with a shift, and the state with the barrier that it is for, if it chooses that."""
        native, is_aimed = state.native, predicts(state, self.tolerance)
        if is_aimed:
            native.aim(0.0)
        factorisation = factorise(state, shift * self.control_weight)
        if not (factorisation.ok and factorisation.negative == native.num_end_conditions):
            if is_aimed:
                native.aim(state.barrier)
            return _Tried(state, shift, factorisation, None)
        state, found = aim_barrier(state, self.tolerance) if is_aimed else (state, native.solve())
        return _Tried(state, shift, factorisation, found.capped(state.may_stop) if found.finite else None)

    def _sharpen(self, state: NewtonState) -> NewtonState:
        """Raise the barrier while the system is singular without a shift; else try without the shift."""
        tried = self._linearise(state, 0.0)
        if not tried.factorisation.ok:
            return raise_barrier(state, self.tolerance)
        return state if tried.direction is None else state._replace(shift=0.0)

    def _restart_multipliers(self, state: NewtonState) -> NewtonState:
        """Keep the motion, with multipliers that know nothing of the way there."""
        native = state.native
        native.m, native.eta = np.zeros_like(native.m), np.zeros_like(native.eta)
        if native.slack.size:
            native.start_limits(state.barrier)
        evaluation = native.evaluate()
        return state._replace(
            evaluation=evaluation,
            shift=0.0,
            filter=first_filter(evaluation),
            restarts=state.restarts + 1,
        )

    def _restore_feasibility(self, state: NewtonState, shift: float) -> NewtonState | None:
        """Sweep along the iterate; None, with the iterate back, if that is no gain.

        What remains of the violation is the end condition's.
        """
        if state.evaluation.is_feasible:
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
                    filter=state.filter.with_corner(state.evaluation),
                    patience=_PAUSE,
                )
        kept.restore(native)
        native.evaluate()
        self._linearise(state, shift)  # the kernel holds the direction again
        return None

    def _relax(self, state: NewtonState) -> NewtonState:
        """Take one full step that nobody judges; a run of them ends in progress, or is undone."""
        reference = state.reference
        assert reference is not None  # for the type checker: `step` comes here only with one
        tried = self._linearise(state, state.shift)
        while tried.direction is None and tried.shift <= MAX_SHIFT:
            tried = self._linearise(state, bold().larger_shift(tried.shift, _MIN_SHIFT))
        if tried.direction is not None:
            after = self._move_unjudged(state, tried, tried.direction, reference)
            if state.filter.accepts_after_relaxation(reference.evaluation, after.evaluation):
                return after._replace(reference=None, filter=state.filter.with_corner(reference.evaluation))
            if after.failure is None and after.reference is not None and after.reference.steps_left:
                return after
        reference.iterate.restore(state.native)
        return state._replace(
            evaluation=state.native.evaluate(),
            iteration=state.iteration + 1,
            increment=math.inf,
            step_length=0.0,
            reference=None,
            patience=_PAUSE,
        )

    def _move_unjudged(
        self, state: NewtonState, tried: _Tried, direction: KernelCappedDirection, reference: Reference
    ) -> NewtonState:
        """Take a full step; another one may follow while there are steps left, or this one is promising."""
        native, shift = state.native, tried.shift
        native.move(direction.longest)
        native.accept(direction.longest, direction.longest_dual)
        evaluation = native.evaluate()
        ratio = evaluation.residual / state.evaluation.residual
        is_promising = evaluation.residual < _PROMISING * state.evaluation.residual
        return next_state(
            state,
            evaluation,
            direction.increment,
            direction.longest,
            augmentation=tried.factorisation.augmentation,
            regularisation=shift,
            shift=bold().next_shift(shift, 1.0, ratio, _MIN_SHIFT),
            reference=replace(reference, steps_left=max(reference.steps_left - 1, int(is_promising))),
            at_minimum=shift == 0.0,
        )
