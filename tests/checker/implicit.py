"""SE1, SE2, the midpoint rule and semi-implicit Euler, with Pinocchio's inverse dynamics and its derivatives.

Unknowns of a step: (q_n, v_n), the multipliers lambda_n, the control u_{n-1}. Rows: kinematics, momentum
balance times dt, constraints.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from tests.checker.costs import Sample
from tests.checker.differences import derivative
from tests.checker.system import Array, System

__all__ = ["TAU", "ImplicitStep", "Linearised"]

TAU = {"se1": 1.0, "se2": 0.0, "midpoint": 0.5, "semi_implicit_euler": 0.0}  # of forces and cost
SHARE = {**TAU, "semi_implicit_euler": 1.0}  # of the velocity that configurations move with


class Linearised(NamedTuple):
    """Rows of a step, how large the terms are that cancel in them, and their derivatives."""

    rows: Array
    sizes: Array
    before: Array  # in the tangent of x_{n-1}
    after: Array
    lam: Array
    u: Array


class ImplicitStep:
    """One step of the tau family."""

    def __init__(self, system: System, scheme: str, dt: float) -> None:
        self.system, self.tau, self.dt = system, TAU[scheme], dt
        self.share = SHARE[scheme]
        self.nx = 2 * system.nv

    def split(self, x: Array) -> tuple[Array, Array]:
        return x[: self.system.nq], x[self.system.nq :]

    def move(self, x: Array, dx: Array) -> Array:
        q, v = self.split(x)
        nv = self.system.nv
        return np.concatenate([self.system.step(q, dx[:nv]), v + dx[nv:]])

    def at(self, x0: Array, x1: Array) -> tuple[Array, Array]:
        """Where forces and running cost are evaluated."""
        (q0, v0), (q1, v1) = self.split(x0), self.split(x1)
        if self.tau == 1.0:
            return q1, v1
        if self.tau == 0.0:
            return q0, v0
        v = (1 - self.tau) * v0 + self.tau * v1
        return self.system.step(q0, self.tau * self.dt * v), v

    def rate(self, v0: Array, v1: Array) -> Array:
        """Velocity that the configuration moves with."""
        return (1 - self.share) * v0 + self.share * v1

    def point(self, x0: Array, x1: Array, u: Array) -> tuple[Array, Array]:
        """The same; for all schemes."""
        return self.at(x0, x1)

    def places(self, x0: Array, x1: Array, u: Array) -> list[tuple[float, Array, Array]]:
        """Weight, configuration and velocity of it."""
        return [(1.0, *self.point(x0, x1, u))]

    def samples(self, x0: Array, x1: Array, u: Array) -> list[Sample]:
        """The same with its derivatives."""
        return [Sample(1.0, *self.point(x0, x1, u), *self.point_maps(x0, x1, u))]

    def point_maps(self, x0: Array, x1: Array, u: Array) -> tuple[Array, Array, Array]:
        """Derivatives of that point in x_{n-1}, x_n and u."""
        nv, tau = self.system.nv, self.tau
        by_u, identity = np.zeros((2 * nv, u.size)), np.eye(2 * nv)
        if tau in (0.0, 1.0):
            return (1 - tau) * identity, tau * identity, by_u
        (q0, v0), (_, v1) = self.split(x0), self.split(x1)
        half = tau * self.dt * ((1 - tau) * v0 + tau * v1)
        first, second = pin.ArgumentPosition.ARG0, pin.ArgumentPosition.ARG1
        q_q0 = pin.dIntegrate(self.system.model, q0, half, first)
        q_v = tau * self.dt * pin.dIntegrate(self.system.model, q0, half, second)
        zero, one = np.zeros((nv, nv)), np.eye(nv)
        before = np.block([[q_q0, (1 - tau) * q_v], [zero, (1 - tau) * one]])
        after = np.block([[zero, tau * q_v], [zero, tau * one]])
        return before, after, by_u

    def rows(self, x0: Array, x1: Array, lam: Array, u: Array) -> tuple[Array, Array]:
        """Residual, and the size of what cancels in each row."""
        s, dt = self.system, self.dt
        (q0, v0), (q1, v1) = self.split(x0), self.split(x1)
        q, v = self.at(x0, x1)
        w = dt * self.rate(v0, v1)
        kinematic = s.away(q1, s.step(q0, w))
        moved = np.abs(w)
        needed = np.asarray(pin.rnea(s.model, s.data, q, v, (v1 - v0) / dt)).copy()
        applied, reaction = s.applied(q, v, u), s.Phi_q(q).T @ lam
        momentum = dt * (applied - needed - reaction)
        weight = np.asarray(pin.computeGeneralizedGravity(s.model, s.data, q))
        terms = dt * (np.abs(applied) + np.abs(needed) + np.abs(reaction) + np.abs(weight))
        position = s.step(q1, dt * v1) if self.share == 0.0 else q1
        constraint = s.Phi(position)
        rows = np.concatenate([kinematic, momentum, constraint])
        sizes = np.concatenate([moved, terms, np.full(s.nc, 1.0)])
        return rows, sizes

    def multipliers(self, x0: Array, x1: Array, u: Array) -> Array:
        """Those that balance the momentum best."""
        s = self.system
        if not s.nc:
            return np.zeros(0)
        rows, _ = self.rows(x0, x1, np.zeros(s.nc), u)
        q, _ = self.at(x0, x1)
        found, *_ = np.linalg.lstsq(s.Phi_q(q).T, rows[s.nv : 2 * s.nv] / self.dt, rcond=None)
        return np.asarray(found)

    def linearise(self, x0: Array, x1: Array, lam: Array, u: Array) -> Linearised:
        s, dt, tau, nv, nc = self.system, self.dt, self.tau, self.system.nv, self.system.nc
        (q0, v0), (q1, v1) = self.split(x0), self.split(x1)
        q, v = self.at(x0, x1)
        rows, sizes = self.rows(x0, x1, lam, u)
        first, second = pin.ArgumentPosition.ARG0, pin.ArgumentPosition.ARG1
        w, share = dt * self.rate(v0, v1), self.share
        reached = s.step(q0, w)
        d_q1 = pin.dDifference(s.model, q1, reached, first)
        d_reached = pin.dDifference(s.model, q1, reached, second)
        k_q0 = d_reached @ pin.dIntegrate(s.model, q0, w, first)
        k_v = dt * d_reached @ pin.dIntegrate(s.model, q0, w, second)
        F_q, F_v, M = self._momentum_derivatives(q, v, (v1 - v0) / dt, lam, u)
        identity, zero = np.eye(nv), np.zeros((nv, nv))
        if tau == 1.0:
            q_q0, q_v, q_q1 = zero, zero, identity
        elif tau == 0.0:
            q_q0, q_v, q_q1 = identity, zero, zero
        else:
            half = tau * dt * v
            q_q0 = pin.dIntegrate(s.model, q0, half, first)
            q_v = tau * dt * pin.dIntegrate(s.model, q0, half, second)
            q_q1 = zero
        m_v = F_q @ q_v + F_v
        before = np.block([[k_q0, (1 - share) * k_v], [F_q @ q_q0, (1 - tau) * m_v + M]])
        after = np.block([[d_q1, share * k_v], [F_q @ q_q1, tau * m_v - M]])
        if nc:
            bottom = np.zeros((nc, 2 * nv))
            if share == 0.0:
                w1 = dt * v1
                J = s.Phi_q(s.step(q1, w1))
                bottom[:, :nv] = J @ pin.dIntegrate(s.model, q1, w1, first)
                bottom[:, nv:] = dt * J @ pin.dIntegrate(s.model, q1, w1, second)
            else:
                bottom[:, :nv] = s.Phi_q(q1)
            before, after = np.vstack([before, np.zeros((nc, 2 * nv))]), np.vstack([after, bottom])
        lam_part, u_part = np.zeros((2 * nv + nc, nc)), np.zeros((2 * nv + nc, s.nu))
        lam_part[nv : 2 * nv] = -dt * s.Phi_q(q).T
        u_part[nv : 2 * nv] = dt * s.actuation(q)
        return Linearised(rows, sizes, before, after, lam_part, u_part)

    def _momentum_derivatives(
        self, q: Array, v: Array, a: Array, lam: Array, u: Array
    ) -> tuple[Array, Array, Array]:
        """Derivatives of dt (applied - rnea - Phi_q' lam) in q and v, and M."""
        s, dt = self.system, self.dt
        r_q, r_v, _ = pin.computeRNEADerivatives(s.model, s.data, q, v, a)
        F_q, F_v = -dt * np.array(r_q), -dt * (np.array(r_v) + np.diag(s.damping))
        if not s.has_constant_force or s.nc:

            def force(dq: Array) -> Array:
                at = s.step(q, dq)
                return s.applied(at, v, u) - s.Phi_q(at).T @ lam

            F_q = F_q + dt * derivative(force, s.nv)
        return F_q, F_v, s.mass(q)
