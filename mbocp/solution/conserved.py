"""Conserved quantities of a solution: what they are, their values, and how well they are kept."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mbocp._arrays import Array, dataclass

_ZERO_RATIO = 1e-9  # of the largest adjoint; a quantity below it is round-off of terms that cancel


@dataclass(frozen=True)
class ConservedQuantity:
    """A control momentum, eq. (15), that a symmetry of robot and running cost keeps constant.

    Attributes
    ----------
    name : str
        The symmetry: "rotation about z".
    meaning : str
        What it is in terms of the adjoints: "adjoint mu_q of shoulder_pan_joint, a cyclic coordinate".
    value : float
        At the start [cost/m or cost/rad]: how much the cost grows when the start is moved along the symmetry.
    drift : float
        Largest change since the start.
    relative_drift : float
        The same over the size of the value; NaN where the value vanishes.
    """

    name: str
    meaning: str
    value: float
    drift: float
    relative_drift: float

    @property
    def vanishes(self) -> bool:
        """Whether the value is zero but for round-off."""
        return math.isfinite(self.value) and math.isnan(self.relative_drift)


def sum_up_momenta(
    momenta: Array, names: Sequence[str], meanings: Sequence[str], mus: Array
) -> tuple[ConservedQuantity, ...]:
    """Sum up the control momenta.

    Parameters
    ----------
    momenta : ndarray, shape (N + 1, k)
    names, meanings : sequence of str, length k
    mus : ndarray, shape (N + 1, 2 nv)
        Adjoints: their size says what counts as zero.
    """
    zero = _ZERO_RATIO * float(np.abs(mus).max(initial=0.0))
    found = []
    for name, meaning, column in zip(names, meanings, momenta.T, strict=True):
        value, drift = float(column[0]), float(np.abs(column - column[0]).max())
        relative = drift / abs(value) if abs(value) > zero else math.nan
        found.append(ConservedQuantity(name, meaning, value, drift, relative))
    return tuple(found)
