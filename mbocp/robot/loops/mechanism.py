"""The interface of a robot to the functions that close its loops."""

from __future__ import annotations

from typing import Protocol

import pinocchio as pin
from numpy.typing import ArrayLike

from mbocp._arrays import Array
from mbocp.robot.loops.constraints import Constraint
from mbocp.robot.parts import Label


class Mechanism(Protocol):
    """A multibody system with holonomic constraints, see `mbocp.robot.Robot`.

    `Robot` itself closes loops by the functions of this package; they know it by this interface.
    """

    @property
    def name(self) -> str:
        """Name for messages."""

    @property
    def model(self) -> pin.Model:
        """Tree of joints and inertias."""

    @property
    def nv(self) -> int:
        """Length of v."""

    @property
    def nc(self) -> int:
        """Number of rows that the equations keep."""

    @property
    def q0(self) -> Array:
        """Initial pose, shape (nq,)."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """Holonomic constraints."""

    @property
    def closure_labels(self) -> tuple[Label, ...]:
        """Name and unit of each row of the constraints, the redundant ones included."""

    @property
    def constraint_labels(self) -> tuple[Label, ...]:
        """Name and unit of each row that the equations keep."""

    @property
    def kept_rows(self) -> tuple[int, ...]:
        """Rows that the equations keep, counted over all constraints in order."""

    @property
    def redundant_rows(self) -> tuple[int, ...]:
        """Rows that the equations leave out."""

    def configuration_indices(self, joint: str) -> slice:
        """Range of a joint in q."""

    def velocity_indices(self, joint: str) -> slice:
        """Range of a joint in v."""

    def integrate(self, q: ArrayLike, dv: ArrayLike) -> Array:
        """Move from `q` along the tangent vector `dv`, shape (nq,)."""

    def difference(self, q0: ArrayLike, q1: ArrayLike) -> Array:
        """Tangent vector at `q0` that leads to `q1`, shape (nv,)."""

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Joint-space mass matrix, shape (nv, nv)."""

    def constraint_jacobian(self, q: ArrayLike) -> Array:
        """Derivative of the kept rows in tangent coordinates, shape (nc, nv)."""

    def closure_residual(self, q: ArrayLike) -> Array:
        """Residual of all rows [m, rad, m^2]."""

    def closure_jacobian(self, q: ArrayLike) -> Array:
        """Derivative of all rows in tangent coordinates, shape (rows, nv)."""

    def closure_along(self, qs: ArrayLike) -> tuple[Array, Array]:
        """Residuals (n, rows) and their derivatives (n, rows, nv) at n configurations."""
