"""What closing the loops of a robot needs of it: its group, its mass matrix and its constraints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from mbocp._arrays import Array, frozen_array
from mbocp.exceptions import InvalidValue
from mbocp.robot import kinematics
from mbocp.robot.loops.residual import Closure
from mbocp.robot.model import RobotModel


@dataclass(frozen=True, eq=False, repr=False)
class Mechanism(RobotModel):
    """A multibody system with holonomic constraints, see `mbocp.robot.Robot`.

    `Robot` itself closes loops and solves for poses by functions of this package; they know it as this.
    """

    def integrate(self, q: ArrayLike, dv: ArrayLike) -> Array:
        """Move from `q` along the tangent vector `dv`: q ∘ exp(dv), shape (nq,)."""
        q, dv = self._vector(q, self.nq, "q"), self._vector(dv, self.nv, "dv")
        return frozen_array(pin.integrate(self.model, q, dv))

    def difference(self, q0: ArrayLike, q1: ArrayLike) -> Array:
        """Tangent vector at `q0` that leads to `q1`, shape (nv,)."""
        q0, q1 = self._vector(q0, self.nq, "q0"), self._vector(q1, self.nq, "q1")
        return frozen_array(pin.difference(self.model, q0, q1))

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Joint-space mass matrix M(q), shape (nv, nv) [kg, kg m, kg m^2]."""
        return frozen_array(kinematics.mass_matrix(self.model, self._vector(q, self.nq, "q")))

    def constraint_residual(self, q: ArrayLike) -> Array:
        """Phi(q), the rows that the equations keep, shape (nc,) [m, rad, m^2]."""
        return frozen_array(self.closure_residual(q)[self._kept])

    def constraint_jacobian(self, q: ArrayLike) -> Array:
        """dPhi_dq in tangent coordinates, the rows that the equations keep, shape (nc, nv)."""
        return frozen_array(self.closure_jacobian(q)[self._kept])

    def closure_residual(self, q: ArrayLike) -> Array:
        """Residual of all rows of the constraints, the redundant ones included [m, rad, m^2]."""
        return frozen_array(self._closure.residual(self._vector(q, self.nq, "q")))

    def closure_jacobian(self, q: ArrayLike) -> Array:
        """Derivative of `closure_residual` in tangent coordinates, shape (rows, nv)."""
        return frozen_array(self._closure.jacobian(self._vector(q, self.nq, "q")))

    def closure_along(self, qs: ArrayLike) -> tuple[Array, Array]:
        """`closure_residual` and `closure_jacobian` at many configurations, faster than one by one.

        Parameters
        ----------
        qs : array_like, shape (n, nq)

        Returns
        -------
        residuals : ndarray, shape (n, rows)
            [m, rad, m^2].
        jacobians : ndarray, shape (n, rows, nv)
        """
        array = frozen_array(qs, shape=(None, self.nq), name=f"robot {self.name!r}: qs")
        if not np.isfinite(array).all():
            raise InvalidValue(f"robot {self.name!r}: qs", "numbers that are not finite", "finite numbers")
        residuals, jacobians = self._closure.along(array)
        return frozen_array(residuals), frozen_array(jacobians)

    @cached_property
    def _closure(self) -> Closure:
        return Closure(self.model, self.constraints)

    @property
    def _kept(self) -> NDArray[np.intp]:
        return np.array(self.kept_rows, dtype=np.intp)

    def _vector(self, value: ArrayLike, size: int, name: str) -> Array:
        array = frozen_array(value, shape=(size,), name=f"robot {self.name!r}: {name}")
        if not np.isfinite(array).all():
            raise InvalidValue(f"robot {self.name!r}: {name}", array.tolist(), "finite numbers")
        return array
