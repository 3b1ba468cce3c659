"""Gauss's method of two stages as a textbook has it, for robots whose configurations are plain numbers.

Positions move with the velocities of the stages, momenta p = M(q) v with the forces there:

    q_i = q_0 + dt sum_j a_ij v_j,    p_i = p_0 + dt sum_j a_ij f_j,    f = dT/dq - dV/dq + forces

([Hairer2006], section II.1.3), and dT/dq = C(q, v)' v with Pinocchio's matrix of Coriolis. The stages are
eliminated, so that a step gives the state at its end, as an explicit one does.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from tests.checker.costs import Sample
from tests.checker.differences import derivative
from tests.checker.explicit import ExplicitStep
from tests.checker.implicit import Linearised
from tests.checker.system import Array, System

__all__ = ["GAUSS", "GaussStep"]

GAUSS = ("gauss2",)
_A = np.array([[1 / 4, 1 / 4 - np.sqrt(3) / 6], [1 / 4 + np.sqrt(3) / 6, 1 / 4]])
_B = np.array([0.5, 0.5])
_ITERATIONS = 30
_EXACT = 1e-14  # of the largest velocity
_SLOW = 0.1  # shrink steps no faster than to this share of the last, slopes are taken anew


def _once(function: Callable[[Array, Array], tuple[Array, Array]]) -> Callable[..., tuple[Array, Array]]:
    """Keep what a function finds for a state and controls."""
    found: dict[bytes, tuple[Array, Array]] = {}

    def find(x0: Array, u: Array) -> tuple[Array, Array]:
        key = np.append(x0, u).tobytes()
        if key not in found:
            found[key] = function(x0, u)
        return found[key]

    return find


class GaussStep(ExplicitStep):
    """One step; the state is (q, v)."""

    def __init__(self, system: System, scheme: str, dt: float) -> None:
        if not system.is_vector or system.nc or system.drives:
            raise NotImplementedError("the checker's Gauss steps are for open chains of plain numbers")
        self.system, self.dt, self.nx = system, dt, 2 * system.nv
        self.stages, self._by_stages = _once(self._stages), _once(self._slopes_of_stages)

    def force(self, q: Array, v: Array, u: Array) -> Array:
        """Rate of the momentum."""
        s = self.system
        coriolis = np.array(pin.computeCoriolisMatrix(s.model, s.data, q, v))
        weight = np.array(pin.computeGeneralizedGravity(s.model, s.data, q))
        return coriolis.T @ v - weight + s.applied(q, v, u)

    def _places(self, vs: Array, x0: Array) -> Array:
        return x0[: self.system.nq] + self.dt * _A @ vs

    def _missing(self, vs: Array, x0: Array, u: Array) -> Array:
        """Balance of the momenta of both stages."""
        q0, v0 = self.split(x0)
        qs, mass = self._places(vs, x0), self.system.mass
        forces = np.array([self.force(q, v, u) for q, v in zip(qs, vs, strict=True)])
        momenta = np.array([mass(q) @ v for q, v in zip(qs, vs, strict=True)])
        return np.asarray(momenta - mass(q0) @ v0 - self.dt * _A @ forces)

    def _slopes(self, vs: Array, x0: Array, u: Array) -> Array:
        scales = np.full(vs.size, 1 / self.dt)
        return derivative(
            lambda d: self._missing(vs + d.reshape(vs.shape), x0, u).ravel(), vs.size, np.minimum(scales, 1.0)
        )

    def _stages(self, x0: Array, u: Array) -> tuple[Array, Array]:
        """Configurations and velocities of both, shape (2, nv) each."""
        vs, before, slopes = np.tile(self.split(x0)[1], (2, 1)), 0.0, np.zeros(0)
        for _ in range(_ITERATIONS):
            with np.errstate(over="ignore", invalid="ignore"):
                if not slopes.size:
                    slopes = self._slopes(vs, x0, u)
                change = np.linalg.solve(slopes, -self._missing(vs, x0, u).ravel())
            vs, size = vs + change.reshape(vs.shape), np.abs(change).max()
            if not size > _EXACT * (1.0 + np.abs(vs).max()):
                break
            if size > _SLOW * before:  # slopes of states further back serve while steps shrink
                slopes = np.zeros(0)
            before = size
        return self._places(vs, x0), vs

    def _end(self, vs: Array, x0: Array, u: Array) -> Array:
        """State at the end, by the stages' velocities."""
        q0, v0 = self.split(x0)
        qs, mass = self._places(vs, x0), self.system.mass
        forces = np.array([self.force(q, v, u) for q, v in zip(qs, vs, strict=True)])
        q1 = q0 + self.dt * _B @ vs
        return np.concatenate([q1, np.linalg.solve(mass(q1), mass(q0) @ v0 + self.dt * _B @ forces)])

    def after(self, x0: Array, u: Array) -> Array:
        return self._end(self.stages(x0, u)[1], x0, u)

    def _slopes_of_stages(self, x0: Array, u: Array) -> tuple[Array, Array]:
        """Derivatives of the stages' velocities in x_{n-1} and u, by the implicit function theorem."""
        vs = self.stages(x0, u)[1]
        slopes, sizes = self._slopes(vs, x0, u), np.maximum(np.abs(u), 1.0)
        by_x = derivative(lambda d: self._missing(vs, x0 + d, u).ravel(), self.nx)
        by_u = derivative(lambda d: self._missing(vs, x0, u + d).ravel(), u.size, sizes)
        return -np.linalg.solve(slopes, by_x), -np.linalg.solve(slopes, by_u)

    def linearise(self, x0: Array, x1: Array, lam: Array, u: Array) -> Linearised:
        rows, sizes = self.rows(x0, x1, lam, u)
        _, vs = self.stages(x0, u)
        vs_x, vs_u = self._by_stages(x0, u)
        on_vs = derivative(lambda d: self._end(vs + d.reshape(vs.shape), x0, u), vs.size)
        before = derivative(lambda d: self._end(vs, x0 + d, u), self.nx) + on_vs @ vs_x
        by_u = derivative(lambda d: self._end(vs, x0, u + d), u.size, np.maximum(np.abs(u), 1.0))
        return Linearised(rows, sizes, before, -np.eye(self.nx), np.zeros((self.nx, 0)), by_u + on_vs @ vs_u)

    def samples(self, x0: Array, x1: Array, u: Array) -> list[Sample]:
        """The stages, with the weights of the scheme."""
        qs, vs = self.stages(x0, u)
        vs_x, vs_u = self._by_stages(x0, u)
        nv = self.system.nv
        found = []
        for i, weight in enumerate(_B):
            on_q = self.dt * np.kron(_A[i], np.eye(nv))
            of_v = slice(i * nv, (i + 1) * nv)
            before = np.vstack([on_q @ vs_x + np.eye(nv, self.nx), vs_x[of_v]])
            by_u = np.vstack([on_q @ vs_u, vs_u[of_v]])
            found.append(Sample(float(weight), qs[i], vs[i], before, np.zeros((2 * nv, self.nx)), by_u))
        return found

    def places(self, x0: Array, x1: Array, u: Array) -> list[tuple[float, Array, Array]]:
        """Weights, configurations and velocities of the samples."""
        qs, vs = self.stages(x0, u)
        return [(float(b), q, v) for b, q, v in zip(_B, qs, vs, strict=True)]
