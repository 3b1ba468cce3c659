r"""FBSM-Newton: Newton's method on :math:`r_u(\omega)`, :math:`\omega = (\eta, u)`, 5.2.1 and Algorithm 2.

Every iterate is swept: state and adjoint satisfy their equations, and the end condition and the control
equation are left, eq. (31). The step :math:`c = -K^{-1} r_u`, :math:`K = \nabla_\omega r_u`, comes from

- the structured factorisation at the swept trajectory. Where the state and adjoint equations hold, a step of
  the whole system, eq. (23), has the same (eta, u) part as the reduced one: linear in the number of steps.
- the dense K, assembled column by column from linearised sweeps. Exact; the reference.
- the dense K by finite differences of r_u: the paper's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import SolverError
from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import Iterate
from mbocp.programme.kernel import kernel_programme
from mbocp.programme.native_modules import kernel
from mbocp.solvers.newton_method.newton import PlainState, check_termination, factorise, new_state, next_state
from mbocp.solvers.options import SOLVER_TOLERANCE
from mbocp.solvers.records import Status
from mbocp.solvers.staggered.sweep import Kept, Sweeps, init_sweeps

if TYPE_CHECKING:
    from mbocp.programme.native_modules import Evaluation, KernelProgramme

_HALVINGS = 10  # i_max of Algorithm 2
_MIN_SHIFT, _MAX_SHIFT = 1e-3, 1e10
_MAX_DENSE_UNKNOWNS = 6000  # unknowns (eta, u) up to which a dense K is assembled: 288 MB
_DIFFERENCE = 1.5e-8  # relative step of the forward differences


@dataclass(frozen=True)
class FBSMNewton:
    r"""Staggered solver with Newton steps.

    Attributes
    ----------
    tolerance : float
        Of :math:`\|r_u\|` and of the step in :math:`\omega`, both Euclidean norms.
    max_iterations : int
        Newton steps before it gives up.
    control_weight : float
        Unit of the shift: the running cost's weight of one control over one step.
    globalised : bool
        False: Algorithm 2. The step is halved until :math:`\|r_u\|` falls, at most ten times, and then taken.
        True: the Hessian is shifted until the step leads towards a minimum, and a step is also good if the
        filter of the monolithic solver takes it, for its cost or its end condition. Where eta is not given,
        and after a shortened or shifted step, it is the one for which r_u is smallest.
    hessian : {"structured", "dense", "finite-difference"}
    auxiliary : bool
        Sweep backward with the auxiliary adjoint, section 5.2.2.
    loop : {"auto", "open", "closed"}
        See `mbocp.solvers.staggered.sweep`.
    """

    tolerance: float = SOLVER_TOLERANCE
    max_iterations: int = 200
    control_weight: float = 1.0
    globalised: bool = True
    hessian: str = "structured"
    auxiliary: bool = False
    loop: str = "auto"

    @property
    def name(self) -> str:
        """Words for output."""
        how = "inertia correction, filter" if self.globalised else "backtracking"
        extra = "" if self.hessian == "structured" else f", {self.hessian} Hessian"
        return f"FBSM-Newton ({how}{extra}{', auxiliary adjoint' if self.auxiliary else ''})"

    def init(self, programme: StagewiseProgramme, iterate: Iterate) -> PlainState:
        """Swept state for the iterate's controls.

        Raises
        ------
        SolverError
            If K is to be dense and is too large for it.
        """
        iterate.check(programme)
        size = iterate.eta.size + iterate.us.size
        if self.hessian != "structured" and size > _MAX_DENSE_UNKNOWNS:
            raise SolverError(
                f'solver.hessian = "{self.hessian}" takes a dense matrix of {size} x {size} entries, '
                f'more than {_MAX_DENSE_UNKNOWNS} x {_MAX_DENSE_UNKNOWNS}; use "structured" or fewer steps'
            )
        native = kernel_programme(programme, sweeps=True)
        iterate.load_into(native)
        sweeps, outcome = init_sweeps(native, programme, loop=self.loop, auxiliary=self.auxiliary)
        evaluation = outcome.evaluation
        if evaluation is None:
            state = new_state(programme, native, native.evaluate())
            return state._replace(failure=Status.SWEEP_FAILED, failed_stage=outcome.failed_stage)
        if self.globalised and not iterate.eta.any():
            evaluation = native.find_end_multiplier(sweeps.auxiliary, sweeps.feedback)
        return new_state(programme, native, evaluation)._replace(sweeps=sweeps)

    def step(self, state: PlainState) -> PlainState:
        """Take a step that makes things better, with the smallest shift found that allows one."""
        native, shift, kept = state.native, state.shift, Kept.of(state.native)
        while True:
            native.evaluate()
            factorisation = factorise(state, shift * self.control_weight)
            is_minimum = factorisation.ok and factorisation.negative == len(native.eta)
            may_go = is_minimum if self.globalised else factorisation.ok
            found = self._go(state, kept, shift) if may_go else None
            if found is not None:
                step, taken = found
                return next_state(
                    state,
                    taken.evaluation,
                    float(np.linalg.norm(step)),
                    taken.length,
                    augmentation=factorisation.augmentation,
                    regularisation=shift,
                    shift=self._next_shift(state, shift, taken),
                    filter=state.filter if taken.keeps_filter else state.filter.with_corner(state.evaluation),
                    at_minimum=is_minimum and shift == 0.0,
                )
            shift = kernel().Care.bold().larger_shift(shift, _MIN_SHIFT)
            if shift > _MAX_SHIFT or not self.globalised:
                stuck = Status.LINE_SEARCH_FAILED if self.globalised else Status.SWEEP_FAILED
                failure = stuck if factorisation.ok else Status.SINGULAR
                return state._replace(failure=failure, failed_stage=factorisation.bad_stage)

    def _go(self, state: PlainState, kept: Kept, shift: float) -> tuple[Array, _AcceptedStep] | None:
        """Solve the factorised system, and go along the step; None where that does not help."""
        direction = state.native.solve()
        step = self._omega_step(state, shift * self.control_weight, kept) if direction.finite else None
        taken = None if step is None else self._search(state, kept, step, direction.slope, shift)
        return None if step is None or taken is None else (step, taken)

    def terminate(self, state: PlainState) -> Status | None:
        """Residual and increment both below the tolerance."""
        return check_termination(state, self.tolerance, self.max_iterations)

    def _omega_step(self, state: PlainState, shift: float, kept: Kept) -> Array | None:
        """Step in (eta, u): the structured one that the kernel holds, or a solution with the dense K."""
        native = state.native
        if self.hessian == "structured":
            return np.concatenate([native.deta, native.du])
        from scipy.linalg import solve  # slow to import, and wanted only for the dense system

        size = len(native.eta) + len(native.u)
        K = native.reduced_hessian(shift).reshape(size, size)
        native.gradient()  # the right-hand side is the open loop's, whichever multipliers the Hessian has
        rhs = _compute_reduced_residual(native)
        if self.hessian == "finite-difference":
            shifted = K - native.reduced_hessian(0.0).reshape(size, size) if shift else 0.0
            K = _differences(native, kept, rhs, auxiliary=self.auxiliary) + shifted
        if not np.isfinite(K).all():
            return None
        try:
            step: Array = -solve(K, rhs)
        except np.linalg.LinAlgError:
            return None
        return step

    def _search(
        self, state: PlainState, kept: Kept, step: Array, slope: float, shift: float
    ) -> _AcceptedStep | None:
        """Sweep with ever shorter steps until one is accepted; None with the start back if none is.

        A sweep that fails shortens the step as one that makes nothing better does.
        """
        native, before, sweeps = state.native, state.evaluation, state.sweeps or Sweeps()
        length = 1.0
        for halving in range(_HALVINGS + 1):
            trial = _sweep_at(native, kept, sweeps, step, length)
            if trial is not None:
                taken = self._judge(state, trial, slope, length, shift, is_last=halving == _HALVINGS)
                if taken is not None:
                    return taken
            length *= 0.5
        kept.restore(native)
        if float(np.linalg.norm(step)) <= self.tolerance and before.residual <= self.tolerance:
            again = sweeps.run(native).evaluation  # round-off hides any decrease
            return None if again is None else _AcceptedStep(again, 0.0)
        return None

    def _judge(
        self,
        state: PlainState,
        trial: Evaluation,
        slope: float,
        length: float,
        shift: float,
        *,
        is_last: bool,
    ) -> _AcceptedStep | None:
        """Take a swept trial, by Algorithm 2's rule or by the filter; None: it makes nothing better."""
        before = state.evaluation
        # The rule says little of a shifted step.
        if trial.residual < before.residual and (shift == 0.0 or not self.globalised):
            return _AcceptedStep(trial, length)
        if not self.globalised:
            return _AcceptedStep(trial, length) if is_last else None
        verdict = state.filter.accepts(before, trial, slope, length)
        if not verdict.is_accepted:
            return None
        if length < 1.0 or shift > 0.0:  # far from Newton's own region the step's eta is a poor one
            sweeps = state.sweeps or Sweeps()
            trial = state.native.find_end_multiplier(sweeps.auxiliary, sweeps.feedback)
        return _AcceptedStep(trial, length, keeps_filter=verdict.by_cost)

    def _next_shift(self, state: PlainState, shift: float, taken: _AcceptedStep) -> float:
        if not self.globalised:
            return 0.0
        contraction = taken.evaluation.residual / state.evaluation.residual
        return kernel().Care.bold().next_shift(shift, taken.length, contraction, _MIN_SHIFT)


@dataclass(frozen=True)
class _AcceptedStep:
    """An accepted step: the swept evaluation, the step length, and whether the filter stays as it is."""

    evaluation: Evaluation
    length: float
    keeps_filter: bool = True


def _sweep_at(
    native: KernelProgramme, kept: Kept, sweeps: Sweeps, step: Array, length: float
) -> Evaluation | None:
    """Sweep with a part of a step in (eta, u); None where the sweep fails."""
    ng = len(native.eta)
    kept.restore(native)
    native.move(length)  # where the states will be to first order: that is where the sweep starts from
    native.accept(length)
    native.eta = kept.eta + length * step[:ng]
    native.u = kept.u + length * step[ng:]
    return sweeps.run(native).evaluation


def _compute_reduced_residual(native: KernelProgramme) -> Array:
    """Derivative of the Lagrangian in (eta, u) after an open sweep: r_u with its control rows times dt."""
    return np.concatenate([native.end_condition, native.control_gradient / native.control_scale])


def _differences(native: KernelProgramme, kept: Kept, rhs: Array, *, auxiliary: bool) -> Array:
    """K by forward differences of the reduced residual, one pair of open sweeps a column."""
    K = np.empty((rhs.size, rhs.size))
    ng, omega = kept.eta.size, np.concatenate([kept.eta, kept.u])
    for j in range(omega.size):
        kept.restore(native)
        moved = omega.copy()
        moved[j] += _DIFFERENCE * max(1.0, abs(omega[j]))
        native.eta, native.u = moved[:ng], moved[ng:]
        if Sweeps(auxiliary).run(native).evaluation is None:
            return np.full_like(K, np.nan)
        K[:, j] = (_compute_reduced_residual(native) - rhs) / (moved[j] - omega[j])
    kept.restore(native)
    return K
