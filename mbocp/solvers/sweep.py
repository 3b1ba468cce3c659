"""The sweeps that every staggered solver makes: state forward, eq. (29), adjoint backward, eq. (30).

After them only r_u, eq. (31), is left: the end condition and the gradient of the control Hamiltonian in the
controls.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mbocp._arrays import Array

__all__ = ["Kept", "Sweep", "sweep"]

_TOLERANCE = 1e-13  # of a step's equations in the programme's scaling: round-off
_ITERATIONS = 50


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

    evaluation: Any
    failed_stage: int = -1


def sweep(native: Any, *, auxiliary: bool = False, warm: bool = True) -> Sweep:
    """State and adjoint for the controls and the multiplier eta that `native` holds.

    Parameters
    ----------
    native : kernel programme
        Its x, y and m are replaced; a warm sweep starts each step from its x and y.
    auxiliary : bool
        Take the adjoint as sigma + A eta, eqs. (42) to (44).
    """
    forward = native.simulate(_TOLERANCE, _ITERATIONS, warm)
    if not forward.ok:
        return Sweep(None, forward.failed_stage)
    evaluation = native.gradient(auxiliary)
    return Sweep(evaluation if evaluation.finite else None)


@dataclass(frozen=True)
class Kept:
    """An iterate of the kernel programme, to go back to."""

    parts: tuple[Array, ...]

    @classmethod
    def of(cls, native: Any) -> Kept:
        """Remember the iterate."""
        return cls((native.x, native.y, native.u, native.m, native.eta))

    def restore(self, native: Any) -> None:
        """Put it back."""
        native.x, native.y, native.u, native.m, native.eta = self.parts
