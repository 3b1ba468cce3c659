r"""The sweeps that every staggered solver makes: state forward, eq. (29), adjoint backward, eq. (30).

After them only r_u, eq. (31), is left: the end condition and the gradient of the control Hamiltonian in the
controls.

*Open and closed loop.* The paper's sweeps run in open loop. On a robot that is unstable, as an arm that holds
its links up or a wrist of little inertia, both of them grow exponentially: in a second or two by factors of
1e5 and, on some arms, 1e50, and no step of the controls survives that. A sweep in closed loop has the
controls answer what the states deviate from those that were planned,

.. math:: u_n = \bar u_n + K_n (x_n - \bar x_n),

with the gains of the structured factorisation. This is another coordinate on the same controls: the result
is an ordinary pair of controls and states, and the adjoint of the closed loop equals that of the open one
where :math:`\nabla_u H = 0`. So both have the same solutions; in closed loop they can be found.

*The end condition's multiplier.* With the sensitivities :math:`G = dg_T/du` of the end condition, which are
adjoints, too, the control equation is linear in eta: :math:`\nabla_u H = h + G^T\eta`. The eta for which it
is smallest makes :math:`\nabla_u H` orthogonal to the rows of G, the gradient on the surface of controls that
reach the goal.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.programme import StagewiseProgramme

if TYPE_CHECKING:
    from mbocp.programme.native_modules import Evaluation, KernelProgramme

_AMPLIFICATION = 100.0  # of the sensitivities by opening the loop, above which it is closed
_GAIN_WEIGHT = (
    100.0  # of states against controls for the gains of the first sweep, in units of a control's weight
)
_RANK = 1e-12  # relative singular value of G below which a row adds nothing


@dataclass(frozen=True)
class Sweep:
    """Outcome of both sweeps.

    Attributes
    ----------
    evaluation : kernel Evaluation or None
        Cost and r_u; None if the forward sweep failed or something is not finite.
    failed_stage : int
        Step in which the forward sweep failed; -1 if it did not.
    """

    evaluation: Evaluation | None
    failed_stage: int = -1


@dataclass(frozen=True)
class Sweeps:
    """How to sweep.

    Attributes
    ----------
    auxiliary : bool
        Take the adjoint as sigma + A eta, eqs. (42) to (44).
    feedback : bool
        In closed loop, with the gains of the kernel programme's last factorisation.
    """

    auxiliary: bool = False
    feedback: bool = False

    def run(self, native: KernelProgramme) -> Sweep:
        """State and adjoint for the controls and eta that `native` holds; its x, y and m are replaced.

        Each step starts from the state and the impulses that `native` holds.
        """
        swept = native.sweep(self.auxiliary, self.feedback)
        return Sweep(swept.evaluation if swept.evaluation.finite else None, swept.failed_stage)

    def backward(self, native: KernelProgramme) -> Evaluation:
        """Adjoint alone; the evaluation that goes with it."""
        return native.gradient(self.auxiliary, self.feedback)


@dataclass(frozen=True)
class Kept:
    """An iterate of the kernel programme, to go back to."""

    x: Array
    y: Array
    u: Array
    m: Array
    eta: Array
    limits: tuple[Array, Array, Array]  # slacks, multipliers of lower and of upper bounds

    @classmethod
    def of(cls, native: KernelProgramme) -> Kept:
        """Remember the iterate."""
        limits = (native.slack, native.z_lower, native.z_upper)
        return cls(native.x, native.y, native.u, native.m, native.eta, limits)

    def restore(self, native: KernelProgramme) -> None:
        """Put it back."""
        native.x, native.y, native.u, native.m, native.eta = self.x, self.y, self.u, self.m, self.eta
        native.slack, native.z_lower, native.z_upper = self.limits


def init_sweeps(
    native: KernelProgramme, programme: StagewiseProgramme, *, loop: str, auxiliary: bool
) -> tuple[Sweeps, Sweep]:
    """Make the first sweep, and with it decide between open and closed loop.

    Parameters
    ----------
    native : kernel programme
        Holds the guess. In closed loop its states are what is planned.
    loop : {"auto", "open", "closed"}
        ``auto``: closed where opening it amplifies the gradient or the end condition's sensitivities a
        hundredfold, or where the open sweep fails.
    auxiliary : bool
        See `Sweeps`.

    Returns
    -------
    sweeps : Sweeps
        How to go on.
    outcome : Sweep
        Of the first one; `native` is left with it.
    """
    opened = Sweeps(auxiliary)
    if loop == "open":
        return opened, opened.run(native)
    closed = Sweeps(auxiliary, feedback=True)
    guess = Kept.of(native)
    if not _find_gains(native, programme):
        guess.restore(native)
        return opened, opened.run(native)
    guess.restore(native)
    if loop == "closed":
        return closed, closed.run(native)
    outcome = opened.run(native)
    reached = Kept.of(native)
    amplified = _sensitivity(native, opened) if outcome.evaluation is not None else np.inf
    guess.restore(native)
    stable = closed.run(native)
    if stable.evaluation is not None and amplified > _AMPLIFICATION * _sensitivity(native, closed):
        return closed, stable
    reached.restore(native)
    if outcome.evaluation is not None:
        opened.backward(native)
    return opened, outcome


def _find_gains(native: KernelProgramme, programme: StagewiseProgramme) -> bool:
    """Gains that hold the guess's states, from the Hessian of the cost alone with a weight on the states."""
    native.m, native.eta = np.zeros_like(native.m), np.zeros_like(native.eta)
    if not native.evaluate().finite:
        return False
    weight = programme.control_weight
    augmentation = 10.0 * weight / programme.dt if programme.ng else 0.0
    return bool(native.factorise(_GAIN_WEIGHT * weight, augmentation).ok)


def _sensitivity(native: KernelProgramme, sweeps: Sweeps) -> float:
    """Size of what a control does to the cost and to the end condition."""
    G = native.end_sensitivity(sweeps.feedback) * np.tile(native.control_scale, len(native.eta))
    return float(np.hypot(np.linalg.norm(G), np.linalg.norm(native.control_gradient)))


@dataclass(frozen=True)
class EndCondition:
    """The end condition and its sensitivities at a swept trajectory, in the metric sum dt |u|^2.

    Attributes
    ----------
    g : ndarray, shape (ng,)
        Values.
    G : ndarray, shape (ng, nu_total)
        Derivatives in all controls, in the scaling of grad_u H.
    weight : ndarray, shape (nu_total,)
        Metric of the controls: the step length of each one's stage.
    """

    g: Array
    G: Array
    weight: Array

    @classmethod
    def of(cls, native: KernelProgramme, *, feedback: bool = False) -> EndCondition:
        """At the last `gradient` of the kernel programme, in open or closed loop as that was."""
        scale, g = native.control_scale, native.end_condition
        return cls(g, native.end_sensitivity(feedback).reshape(g.size, scale.size) * scale, 1.0 / scale)

    def multiplier(self, h: Array) -> Array:
        """The eta for which h + G' eta is smallest, shape (ng,)."""
        root = np.sqrt(self.weight)
        return _least_squares((self.G * root).T, -h * root)

    def restoration(self) -> Array:
        """Smallest change of the controls that makes the linearised end condition hold, shape (nu_total,)."""
        if not self.g.size:
            return np.zeros_like(self.weight)
        root = np.sqrt(self.weight)
        return _least_squares(self.G * root, -self.g) / root


def _least_squares(A: Array, b: Array) -> Array:
    """Smallest x for which A x - b is smallest; NaN where A or b has left the finite numbers."""
    if not (np.isfinite(A).all() and np.isfinite(b).all()):
        return np.full(A.shape[1], np.nan)
    return np.asarray(np.linalg.lstsq(A, b, rcond=_RANK)[0], dtype=np.float64)
