r"""SE1 in natural coordinates, as d'Alembert's principle on positions and directors of the bodies.

Bodies are where the joints put them, z_n = z(q_n), and w_n = (z_n - z_{n-1})/dt. Forces of constraint do no
work along the joints:

.. math:: T(q_n)^T \left(M (w_n - w_{n-1}) - \Delta t\, f\right) = \Delta t\,(B u_{n-1} - \Phi_q^T \lambda_n)

with T = dz/dq. The multipliers of rigid bodies and joints never appear, and the joints have no damping.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from tests.checker.differences import derivative
from tests.checker.system import Array, System

__all__ = ["NaturalSteps"]


class NaturalSteps:
    """Positions, inertia and steps of a system's bodies."""

    def __init__(self, system: System, dt: float) -> None:
        self.system, self.dt = system, dt
        model = system.model
        mass, force = [], []
        for j in range(1, model.njoints):
            inertia = model.inertias[j]
            euler = 0.5 * np.trace(inertia.inertia) * np.eye(3) - inertia.inertia
            block = np.zeros((12, 12))
            block[:3, :3] = inertia.mass * np.eye(3)
            block[3:, 3:] = np.kron(euler, np.eye(3))
            mass.append(block)
            force.append(np.concatenate([inertia.mass * model.gravity.linear, np.zeros(9)]))
        self.mass, self.weight = mass, np.concatenate(force)

    def momentum(self, w: Array) -> Array:
        return np.concatenate([m @ part for m, part in zip(self.mass, w.reshape(-1, 12), strict=True)])

    def bodies(self, q: Array) -> tuple[Array, Array]:
        """z(q), centres of mass and directors, and T(q) = dz/dq."""
        s = self.system
        pin.computeJointJacobians(s.model, s.data, q)
        zs, rows = [], []
        for j in range(1, s.model.njoints):
            place, lever = s.data.oMi[j], s.model.inertias[j].lever
            J = pin.getJointJacobian(s.model, s.data, j, pin.LOCAL_WORLD_ALIGNED)
            R = place.rotation
            zs += [place.act(lever), *R.T]
            rows.append(J[:3] - pin.skew(R @ lever) @ J[3:])
            rows += [-pin.skew(R[:, k]) @ J[3:] for k in range(3)]
        return np.concatenate(zs), np.vstack(rows)

    def row(self, n: int, zs: Array, w_before: Array, q: Array, lam: Array, u: Array) -> tuple[Array, Array]:
        """Balance of step n, and how large the terms are that cancel."""
        s, dt = self.system, self.dt
        z, T = self.bodies(q)
        pushed = self.momentum((z - zs[n - 1]) / dt - w_before)
        applied = s.applied(q, np.zeros(s.nv), u) - s.Phi_q(q).T @ lam
        rows = T.T @ (pushed - dt * self.weight) - dt * applied
        sizes = np.abs(T.T) @ np.abs(pushed) + dt * (np.abs(T.T @ self.weight) + np.abs(applied))
        return rows, sizes

    def linearise(
        self, n: int, zs: Array, Ts: list[Array], w_before: Array, q: Array, lam: Array, u: Array
    ) -> tuple[Array, Array, Array]:
        """Derivatives in q_n, q_{n-1}, q_{n-2}; for n = 1 the rate before is given."""
        s = self.system
        here = derivative(lambda d: self.row(n, zs, w_before, s.step(q, d), lam, u)[0], s.nv)
        T = Ts[n]

        def through(other: Array, factor: float) -> Array:
            weighed = np.column_stack([self.momentum(column) for column in other.T])
            return factor / self.dt * (T.T @ weighed)

        # w_{n-1} = (z_{n-1} - z_{n-2})/dt, and w_0 is the start's
        return here, through(Ts[n - 1], -1.0 if n == 1 else -2.0), through(Ts[n - 2], 1.0)
