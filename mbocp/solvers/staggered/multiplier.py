r"""The end condition's multiplier for given controls.

With the sensitivities :math:`G = dg_T/du` of the end condition, which are adjoints, too, the control equation
is linear in eta: :math:`\nabla_u H = h + G^T\eta`. The eta for which it is smallest makes
:math:`\nabla_u H` orthogonal to the rows of G, the gradient on the surface of controls that reach the goal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array

if TYPE_CHECKING:
    from mbocp.programme.native import KernelProgramme

_RANK = 1e-12  # relative singular value of G below which a row adds nothing


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
        change: Array = _least_squares(self.G * root, -self.g) / root
        return change


def _least_squares(A: Array, b: Array) -> Array:
    """Smallest x for which A x - b is smallest; NaN where A or b has left the finite numbers."""
    if not (np.isfinite(A).all() and np.isfinite(b).all()):
        return np.full(A.shape[1], np.nan)
    return np.asarray(np.linalg.lstsq(A, b, rcond=_RANK)[0], dtype=np.float64)
