"""Bounds of a programme's states, controls and path functions."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass


@dataclass(frozen=True)
class StateBounds:
    """Bounds at the nodes 1..N and in all steps, infinite where there are none.

    Rows that are the same at all nodes may be views of one: `everywhere`. Where both sides of a row are the
    same, it is an equation.

    Attributes
    ----------
    x_lower, x_upper : ndarray, shape (N, nx)
        Of states.
    u_lower, u_upper : ndarray, shape (N, nu)
        Of controls.
    path_lower, path_upper : ndarray, shape (N, nh)
        Of the path functions; squares of distances and speeds.
    """

    x_lower: Array
    x_upper: Array
    u_lower: Array
    u_upper: Array
    path_lower: Array
    path_upper: Array

    @staticmethod
    def everywhere(row: Array, num_steps: int) -> Array:
        """A row for every node, shape (N, n), in the memory of one."""
        return np.broadcast_to(row, (num_steps, len(row)))

    @property
    def nh(self) -> int:
        """Number of path functions."""
        return int(self.path_lower.shape[1])

    @cached_property
    def is_empty(self) -> bool:
        """Whether nothing is bounded."""
        sides = (self.x_lower, self.x_upper, self.u_lower, self.u_upper, self.path_lower, self.path_upper)
        return not any(np.isfinite(_own_rows(side)).any() for side in sides)

    @cached_property
    def has_limit(self) -> BoolArray:
        """Which entries of states, controls and path functions are bounded, shape (N, nx + nu + nh)."""
        return np.isfinite(self.lower) | np.isfinite(self.upper)

    @cached_property
    def lower(self) -> Array:
        """Lower bounds of states, controls and path functions, shape (N, nx + nu + nh)."""
        return np.hstack([self.x_lower, self.u_lower, self.path_lower])

    @cached_property
    def upper(self) -> Array:
        """Upper bounds of states, controls and path functions, shape (N, nx + nu + nh)."""
        return np.hstack([self.x_upper, self.u_upper, self.path_upper])

    @cached_property
    def are_equations(self) -> BoolArray:
        """Which entries have the same bound on both sides, shape (N, nx + nu + nh)."""
        return np.equal(self.lower, self.upper)

    def with_sides(self, lower: Array, upper: Array) -> StateBounds:
        """Others of the same sizes, from bounds of shape (N, nx + nu + nh)."""
        nx, nu = self.x_lower.shape[1], self.u_lower.shape[1]
        (xl, ul, pl), (xu, uu, pu) = (np.split(side, [nx, nx + nu], axis=1) for side in (lower, upper))
        return StateBounds(x_lower=xl, x_upper=xu, u_lower=ul, u_upper=uu, path_lower=pl, path_upper=pu)


def _own_rows(side: Array) -> Array:
    """The one row of a side that has the same for every node in the memory of one."""
    return side[:1] if side.strides[0] == 0 else side
