r"""FBSM-BB: gradient steps between sweeps, with stabilised Barzilai-Borwein lengths, section 5.3.

With s and y the last changes of the controls and of the gradient, the step lengths

.. math:: \theta_1 = \frac{s\cdot s}{|s\cdot y|}, \qquad \theta_2 = \frac{|s\cdot y|}{y\cdot y}

of [Barzilai1988]_ take turns, as in [Dai2005]_, none longer than :math:`\theta_{max} / \|\nabla_u H\|`: the
stabilisation of [Burdakov2019]_, which the paper uses with :math:`\theta_{max} = 1`. Taking turns converges
about as fast as the first alone on the paper's systems, and never much slower.

*Exact end condition.* Towards a saddle point the plain gradient would have u descend and eta ascend, which
circles around it for thousands of iterations. Here eta follows from u: it makes :math:`\nabla_u H` orthogonal
to the sensitivities of the end condition, and a second part of the step, across the surface of controls that
reach the goal, restores the linearised end condition. Neither part is longer than :math:`\theta_{max}`.

*Safeguard.* The merit :math:`J + \rho\|g_T\|` may not exceed its largest value in the last ten iterations; a
step that would, or whose sweep fails, is halved.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import Iterate
from mbocp.programme.kernel import kernel_programme
from mbocp.solvers.options import SOLVER_TOLERANCE, Switch
from mbocp.solvers.protocol import Measures
from mbocp.solvers.records import Status
from mbocp.solvers.staggered.sweep import EndCondition, Kept, Sweeps, init_sweeps

if TYPE_CHECKING:
    from mbocp.programme.native_modules import Evaluation, KernelProgramme

_MEMORY = 10  # iterations that the merit is compared with
_HALVINGS = 40
_ARMIJO = 1e-4
_ROUND_OFF = 1e-13  # of the merit
_CONTROL_ERROR = 1e3  # tolerances: what the controls may be off by, ||r_u|| / alpha at most
_STAGNATION = 500  # iterations without any better residual or merit


@dataclass(frozen=True)
class GradientState:
    """Where the gradient method stands; what it shares with `PlainState` means the same.

    Attributes
    ----------
    gradient : ndarray, shape (nu_total,)
        grad_u H with the best eta, projected on the surface of the end condition.
    plain : ndarray, shape (nu_total,)
        grad_u H without eta's part.
    end : EndCondition
    eta : ndarray, shape (ng,)
        Multiplier that belongs to `gradient`.
    sweeps : Sweeps
        How to sweep.
    before : tuple of ndarray
        Step that led here, and plain gradient and end condition's sensitivities of the iterate before.
    merits : tuple of (float, float)
        Cost and violation of the last iterates.
    penalty : float
        rho of the merit.
    first_cost : float
        Of the guess.
    effort : float
        Weight of a control in the running cost.
    best : tuple of (float, float, int)
        Smallest residual and merit so far, and the iteration that last lowered one of them.
    """

    native: KernelProgramme
    evaluation: Measures
    gradient: Array
    plain: Array
    end: EndCondition
    eta: Array
    sweeps: Sweeps
    before: tuple[Array, Array, Array] | None = None
    merits: tuple[tuple[float, float], ...] = ()
    penalty: float = 0.0
    first_cost: float = math.nan
    effort: float = 0.0
    best: tuple[float, float, int] = (math.inf, math.inf, 0)
    iteration: int = 0
    increment: float = math.inf
    step_length: float = math.nan
    regularisation: float = 0.0
    at_minimum: bool = False
    failure: Status | None = None
    failed_stage: int = -1
    next_increment: float = math.inf  # a gradient's step says nothing of the next one


@dataclass(frozen=True)
class _Residual:
    """An evaluation whose norms belong to the projected gradient."""

    cost: float
    residual: float
    primal: float
    dual: float
    worst: float
    worst_stage: int
    worst_row: int
    complementarity: float

    @classmethod
    def of(cls, evaluation: Evaluation, gradient: Array) -> _Residual:
        """Replace the norm of grad_u H."""
        named = {key: getattr(evaluation, key) for key in cls.__dataclass_fields__}
        dual = float(np.linalg.norm(gradient))
        return cls(**{**named, "dual": dual, "residual": math.hypot(dual, named["primal"])})


@dataclass(frozen=True)
class FBSMGradient:
    r"""Staggered solver with gradient steps.

    Attributes
    ----------
    tolerance : float
        Of :math:`\|r_u\|`, and a thousandth of what :math:`\|r_u\| / \alpha` may be: a bound of the controls'
        error [N, N m]. The length of a step says nothing of a gradient method's error.
    max_iterations : int
        Steps before it gives up.
    theta_max : float
        Longest step, Euclidean norm over all controls.
    auxiliary : bool
        Sweep backward with the auxiliary adjoint, section 5.2.2.
    loop : {"auto", "open", "closed"}
        See `mbocp.solvers.staggered.sweep`.
    switch : Switch or None
        As the first phase of a hybrid: when to end.
    """

    tolerance: float = SOLVER_TOLERANCE
    max_iterations: int = 5000
    theta_max: float = 1.0
    auxiliary: bool = False
    loop: str = "auto"
    switch: Switch | None = None

    @property
    def name(self) -> str:
        """Words for output."""
        return f"FBSM-BB (stabilised Barzilai-Borwein{', auxiliary adjoint' if self.auxiliary else ''})"

    def init(self, programme: StagewiseProgramme, iterate: Iterate) -> GradientState:
        """Swept state for the iterate's controls."""
        iterate.check(programme)
        native = kernel_programme(programme, sweeps=True)
        iterate.load_into(native)
        native.eta = np.zeros(programme.ng)
        sweeps, outcome = init_sweeps(native, programme, loop=self.loop, auxiliary=self.auxiliary)
        if outcome.evaluation is None:
            none = np.zeros(0)
            nowhere = EndCondition(none, none, none)
            failed = GradientState(native, native.evaluate(), none, none, nowhere, none, sweeps)
            return replace(failed, failure=Status.SWEEP_FAILED, failed_stage=outcome.failed_stage)
        state = self._at(native, outcome.evaluation, sweeps)
        e = state.evaluation
        effort = programme.control_weight / programme.dt
        return self._finish(replace(state, first_cost=e.cost, effort=effort, best=(e.residual, math.inf, 0)))

    def step(self, state: GradientState) -> GradientState:
        """One accepted step."""
        native, end = state.native, state.end
        kept = Kept.of(native)
        restoration, share = _shorten(end.restoration(), self.theta_max)
        penalty = max(state.penalty, 2.0 * self._largest_eta(state, restoration))
        merits = (*state.merits, (state.evaluation.cost, float(np.linalg.norm(end.g))))[-_MEMORY:]
        reference = max(cost + penalty * violation for cost, violation in merits)
        direction = restoration - self._length(state) * state.gradient
        slope = float(end.weight @ (state.plain * direction)) - penalty * share * merits[-1][1]
        length = 1.0
        for _ in range(_HALVINGS):
            kept.restore(native)
            native.u = kept.u + length * direction
            native.eta = state.eta
            outcome = state.sweeps.run(native)
            if outcome.evaluation is not None:
                merit = outcome.evaluation.cost + penalty * float(np.linalg.norm(native.end_condition))
                if merit <= reference + _ARMIJO * length * min(slope, 0.0) + _ROUND_OFF * abs(reference):
                    break
            length *= 0.5
        else:
            kept.restore(native)
            state.sweeps.run(native)
            return replace(state, failure=Status.LINE_SEARCH_FAILED)
        after = self._at(native, outcome.evaluation, state.sweeps)
        iteration = state.iteration + 1
        residual, least, since = state.best
        if after.evaluation.residual < residual or merit < least - 1e-10 * abs(least):
            since = iteration
        after = replace(
            after,
            before=(length * direction, state.plain, end.G),
            merits=merits,
            penalty=penalty,
            first_cost=state.first_cost,
            effort=state.effort,
            best=(min(residual, after.evaluation.residual), min(least, merit), since),
            iteration=iteration,
            increment=float(np.linalg.norm(length * direction)),
            step_length=length,
        )
        return self._finish(after)

    def terminate(self, state: GradientState) -> Status | None:
        """Residual below the tolerance; or the switch of a hybrid; or nothing better for long."""
        if state.failure is not None:
            return state.failure
        residual, cost, switch = state.evaluation.residual, state.evaluation.cost, self.switch
        if not math.isfinite(residual):
            return Status.DIVERGED
        if residual <= self.tolerance * min(1.0, _CONTROL_ERROR * state.effort):
            return Status.CONVERGED
        if switch is not None and (
            residual < switch.residual
            or cost < switch.cost * state.first_cost
            or state.iteration >= switch.iterations
        ):
            return Status.SWITCHED
        if state.iteration - state.best[2] >= _STAGNATION:
            return Status.STAGNATED
        return Status.MAX_ITERATIONS if state.iteration >= self.max_iterations else None

    def _at(self, native: KernelProgramme, evaluation: Evaluation, sweeps: Sweeps) -> GradientState:
        """State at a swept iterate, with the eta that suits its controls."""
        end = EndCondition.of(native, feedback=sweeps.feedback)
        gradient, eta = native.control_gradient, native.eta
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite ends as diverged
            plain = gradient - end.G.T @ eta
            if eta.size:
                eta = end.multiplier(plain)
                gradient = plain + end.G.T @ eta
        return GradientState(native, _Residual.of(evaluation, gradient), gradient, plain, end, eta, sweeps)

    def _finish(self, state: GradientState) -> GradientState:
        """At the end the kernel's iterate gets the eta of its controls, and says whether it is a minimum."""
        if self.terminate(state) is None:
            return state
        native = state.native
        kept = Kept.of(native)
        native.eta = state.eta
        state.sweeps.backward(native)
        if not native.evaluate().finite:
            kept.restore(native)
            return replace(state, failure=state.failure or Status.DIVERGED)
        factorisation = native.factorise()
        is_minimum = factorisation.ok and factorisation.negative == state.eta.size
        return replace(state, at_minimum=is_minimum)

    def _largest_eta(self, state: GradientState, restoration: Array) -> float:
        """Size of eta here and after the restoring step; at controls zero eta is zero, whatever the goal."""
        if not state.eta.size:
            return 0.0
        ahead = state.end.multiplier(state.plain + state.effort * restoration)
        return float(max(np.linalg.norm(state.eta), np.linalg.norm(ahead)))

    def _length(self, state: GradientState) -> float:
        """Stabilised Barzilai-Borwein length."""
        size = float(np.linalg.norm(state.gradient))
        longest = self.theta_max / max(size, 1e-300)
        if state.before is None:
            return longest
        s, plain, G = state.before
        y = state.gradient - (plain + G.T @ state.eta)
        sy, yy = abs(float(s @ y)), float(y @ y)
        if not (sy > 0.0 and yy > 0.0):
            return longest
        return min(float(s @ s) / sy if state.iteration % 2 else sy / yy, longest)


def _shorten(vector: Array, longest: float) -> tuple[Array, float]:
    """Vector shortened to the norm `longest`, and the part of it that is left."""
    size = float(np.linalg.norm(vector))
    share = min(1.0, longest / size) if size > 0.0 else 1.0
    return share * vector, share
