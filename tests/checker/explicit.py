"""Explicit Runge-Kutta steps on the joints' groups (Munthe-Kaas), with Pinocchio's accelerations."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from tests.checker.costs import Sample
from tests.checker.differences import derivative
from tests.checker.implicit import Linearised
from tests.checker.system import Array, System

__all__ = ["TABLEAUX", "ExplicitStep"]

# [Hairer1993] table 5.1 for Fehlberg's
TABLEAUX: dict[str, tuple[list[list[float]], list[float]]] = {
    "euler": ([[]], [1.0]),
    "heun": ([[], [1.0]], [0.5, 0.5]),
    "rk4": ([[], [0.5], [0.0, 0.5], [0.0, 0.0, 1.0]], [1 / 6, 1 / 3, 1 / 3, 1 / 6]),
    "rkf5": (
        [
            [],
            [1 / 4],
            [3 / 32, 9 / 32],
            [1932 / 2197, -7200 / 2197, 7296 / 2197],
            [439 / 216, -8.0, 3680 / 513, -845 / 4104],
            [-8 / 27, 2.0, -3544 / 2565, 1859 / 4104, -11 / 40],
        ],
        [16 / 135, 0.0, 6656 / 12825, 28561 / 56430, -9 / 50, 2 / 55],
    ),
}


class ExplicitStep:
    """One step; the state is (q, s) with the speeds s, which are v where there are no drives."""

    def __init__(self, system: System, scheme: str, dt: float) -> None:
        self.system, self.dt = system, dt
        self.a, self.b = TABLEAUX[scheme]
        self.nx = system.nv + system.ns

    def split(self, x: Array) -> tuple[Array, Array]:
        return x[: self.system.nq], x[self.system.nq :]

    def move(self, x: Array, dx: Array) -> Array:
        q, s = self.split(x)
        nv = self.system.nv
        return np.concatenate([self.system.step(q, dx[:nv]), s + dx[nv:]])

    def away(self, x0: Array, x1: Array) -> Array:
        (q0, s0), (q1, s1) = self.split(x0), self.split(x1)
        return np.concatenate([self.system.away(q0, q1), s1 - s0])

    def velocity(self, q: Array, s: Array, u: Array) -> Array:
        if not self.system.drives:
            return s
        V, U = self.system.speed_maps(q)
        return V @ s + U @ u

    def point(self, x0: Array, x1: Array, u: Array) -> tuple[Array, Array]:
        """Where the running cost is evaluated."""
        q, s = self.split(x0)
        return q, self.velocity(q, s, u)

    def places(self, x0: Array, x1: Array, u: Array) -> list[tuple[float, Array, Array]]:
        """Weight, configuration and velocity of it."""
        return [(1.0, *self.point(x0, x1, u))]

    def samples(self, x0: Array, x1: Array, u: Array) -> list[Sample]:
        """The same with its derivatives."""
        return [Sample(1.0, *self.point(x0, x1, u), *self.point_maps(x0, x1, u))]

    def point_maps(self, x0: Array, x1: Array, u: Array) -> tuple[Array, Array, Array]:
        """Derivatives of that point in x_{n-1}, x_n and u."""
        nv = self.system.nv
        before, by_u = np.eye(2 * nv, self.nx), np.zeros((2 * nv, u.size))
        if self.system.drives:
            q, s = self.split(x0)
            V, U = self.system.speed_maps(q)
            before = np.zeros((2 * nv, self.nx))
            before[:nv, :nv] = np.eye(nv)
            turned = derivative(lambda d: self.velocity(self.system.step(q, d), s, u), nv)
            before[nv:, :nv], before[nv:, nv:], by_u[nv:] = turned, V, U
        return before, np.zeros((2 * nv, self.nx)), by_u

    def rate(self, q: Array, s: Array, u: Array) -> Array:
        """ds/dt."""
        system = self.system
        if system.drives:
            return self._hybrid(q, s, u)
        force = system.applied(q, s, u)
        if not system.nc:
            return np.asarray(pin.aba(system.model, system.data, q, s, force)).copy()
        bias = np.asarray(pin.nonLinearEffects(system.model, system.data, q, s)).copy()
        J, M, nc = system.Phi_q(q), system.mass(q), system.nc
        turning = derivative(lambda t: system.Phi_q(system.step(q, t[0] * s)) @ s, 1)[:, 0]
        matrix = np.block([[M, J.T], [J, np.zeros((nc, nc))]])
        return np.asarray(np.linalg.solve(matrix, np.concatenate([force - bias, -turning]))[: system.nv])

    def _hybrid(self, q: Array, s: Array, u: Array) -> Array:
        system = self.system
        free, first = system.free, system.nu - len(system.drives)
        V, _ = system.speed_maps(q)
        pushed = [u[first + k] for k, d in enumerate(system.drives) if d.control == "acceleration"]
        v = self.velocity(q, s, u)
        turning = derivative(lambda t: self.velocity(system.step(q, t[0] * v), s, u), 1)[:, 0]
        known = turning + V @ np.concatenate([np.zeros(len(free)), pushed])
        need = np.asarray(pin.rnea(system.model, system.data, q, v, known)).copy()
        missing = system.applied(q, v, u) - need
        M = system.mass(q)[np.ix_(free, free)]
        return np.concatenate([np.linalg.solve(M, missing[free]), pushed])

    def _pulled_back(self, w: Array, v: Array) -> Array:
        """Eqs. (51), (52) of [Manara2017]: dexp^-1 as far as it is written there."""
        first = self._bracket(w, v)
        return v + first / 2 + self._bracket(w, first) / 12

    def _bracket(self, w: Array, v: Array) -> Array:
        out = np.zeros(self.system.nv)
        for joint in self.system.model.joints[1:]:
            at = slice(joint.idx_v, joint.idx_v + joint.nv)
            if joint.nv == 6:
                out[at] = np.asarray(pin.Motion(w[at]).cross(pin.Motion(v[at])))
            elif joint.nv == 3 and joint.nq == 4:
                out[at] = np.cross(w[at], v[at])
        return out

    def after(self, x0: Array, u: Array) -> Array:
        """State at the end of the step."""
        (q0, s0), h = self.split(x0), self.dt
        turns: list[Array] = []
        rates: list[Array] = []
        for row in self.a:
            w = h * sum((a * k for a, k in zip(row, turns, strict=True)), np.zeros(self.system.nv))
            s = s0 + h * sum((a * k for a, k in zip(row, rates, strict=True)), np.zeros(s0.size))
            q = self.system.step(q0, w)
            turns.append(self._pulled_back(w, self.velocity(q, s, u)))
            rates.append(self.rate(q, s, u))
        w = h * sum((b * k for b, k in zip(self.b, turns, strict=True)), np.zeros(self.system.nv))
        s = s0 + h * sum((b * k for b, k in zip(self.b, rates, strict=True)), np.zeros(s0.size))
        return np.concatenate([self.system.step(q0, w), s])

    def rows(self, x0: Array, x1: Array, lam: Array, u: Array) -> tuple[Array, Array]:
        reached = self.after(x0, u)
        sizes = np.abs(self.away(x0, reached)) + np.concatenate(
            [np.zeros(self.system.nv), np.abs(self.split(x0)[1])]
        )
        return self.away(x1, reached), sizes

    def multipliers(self, x0: Array, x1: Array, u: Array) -> Array:
        return np.zeros(0)

    def linearise(self, x0: Array, x1: Array, lam: Array, u: Array) -> Linearised:
        rows, sizes = self.rows(x0, x1, lam, u)
        if self.system.is_vector and not self.system.nc and not self.system.drives:
            before, by_u = self._chain_rule(x0, u)
            after = -np.eye(self.nx)
        else:
            scales = np.concatenate([np.ones(self.system.nv), np.full(self.nx - self.system.nv, 1 / self.dt)])
            before = derivative(lambda d: self.away(x1, self.after(self.move(x0, d), u)), self.nx, scales)
            reached = self.after(x0, u)
            after = derivative(lambda d: self.away(self.move(x1, d), reached), self.nx, scales)
            sizes_u = np.maximum(np.abs(u), 1.0)
            by_u = derivative(lambda d: self.away(x1, self.after(x0, u + d)), u.size, sizes_u)
        return Linearised(rows, sizes, before, after, np.zeros((self.nx, 0)), by_u)

    def _chain_rule(self, x0: Array, u: Array) -> tuple[Array, Array]:
        """Through the stages, by Pinocchio's derivatives of the forward dynamics."""
        system, h, nv = self.system, self.dt, self.system.nv
        identity = np.eye(2 * nv)
        slopes: list[Array] = []
        by_x: list[Array] = []
        by_u: list[Array] = []
        for row in self.a:
            x, X, U = x0.copy(), identity.copy(), np.zeros((2 * nv, u.size))
            for a, k, kx, ku in zip(row, slopes, by_x, by_u, strict=True):
                x, X, U = x + h * a * k, X + h * a * kx, U + h * a * ku
            q, v = x[:nv], x[nv:]
            force = system.applied(q, v, u)
            d_q, d_v, inverse = pin.computeABADerivatives(system.model, system.data, q, v, force)
            upper = np.triu(np.asarray(inverse))
            inverse = upper + np.triu(upper, 1).T
            d_q, d_v, rate = np.array(d_q), np.array(d_v), np.array(system.data.ddq)
            d_v = d_v - inverse @ np.diag(system.damping)
            B = system.actuation(q)
            if not system.has_constant_force:
                d_q = d_q + inverse @ derivative(
                    lambda d, q=q, v=v: system.applied(system.step(q, d), v, u), nv
                )
            A = np.vstack([identity[nv:], np.hstack([d_q, d_v])])
            slopes.append(np.concatenate([v, rate]))
            by_x.append(A @ X)
            by_u.append(A @ U + np.vstack([np.zeros_like(B), inverse @ B]))
        X, U = identity.copy(), np.zeros((2 * nv, u.size))
        for b, kx, ku in zip(self.b, by_x, by_u, strict=True):
            X, U = X + h * b * kx, U + h * b * ku
        return X, U
