"""Bounds of a programme's states, controls and path functions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbocp._arrays import Array, IntArray

__all__ = ["StateBounds"]


@dataclass(frozen=True)
class StateBounds:
    """Bounds at the nodes 1..N and in all steps, infinite where there are none.

    Attributes
    ----------
    x_lower, x_upper : ndarray, shape (nx,)
        Of states.
    u_lower, u_upper : ndarray, shape (nu,)
        Of controls.
    path_lower, path_upper : ndarray, shape (nh,)
        Of the path functions; squares of distances and speeds.
    """

    x_lower: Array
    x_upper: Array
    u_lower: Array
    u_upper: Array
    path_lower: Array
    path_upper: Array

    @property
    def nh(self) -> int:
        """Number of path functions."""
        return int(self.path_lower.size)

    @property
    def is_empty(self) -> bool:
        """Whether nothing is bounded."""
        sides = [np.isfinite(getattr(self, name)).any() for name in self.__dataclass_fields__]
        return not any(sides) and not self.nh

    @property
    def limited_x(self) -> IntArray:
        """Entries of a state that are bounded."""
        return np.flatnonzero(np.isfinite(self.x_lower) | np.isfinite(self.x_upper))

    @property
    def limited_u(self) -> IntArray:
        """Controls that are bounded."""
        return np.flatnonzero(np.isfinite(self.u_lower) | np.isfinite(self.u_upper))
