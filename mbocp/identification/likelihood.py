r"""Parameters and motion together: maximum likelihood where positions and torques both have errors.

Regression takes measured motions for true ones; noise in accelerations then makes inertias too small. Here
the motion is unknown as well, a spline :math:`y(t) = B(t) c` of fifth degree. The sum of squares

.. math::

    \sum_k \Bigl|\frac{y_k + \delta - y(t_k)}{\sigma_y}\Bigr|^2
    + \Bigl|\frac{\tau_k - Y(y, \dot y, \ddot y)\,\beta}{\sigma_\tau}\Bigr|^2

is minimised over c, the base parameters :math:`\beta`, the speeds :math:`w` of the Coulomb friction
:math:`F \tanh(\dot q / w)`, by their logarithms, and, if asked for, the joint offsets :math:`\delta` by Gauss
and Newton's method: its matrix is banded for c, with a border for the others. Noise levels are those of
the residuals, by the numbers of measurements less the parameters that they determine (Patterson and Thompson
1971).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded, lstsq
from scipy.sparse import bsr_matrix, csr_matrix, diags, eye, kron, vstack

from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue
from mbocp.identification.dynamics import InverseDynamics, JointMotion
from mbocp.identification.unknown_parameters import BaseParameters, Unknowns

DEGREE = 5
_FLOOR = 1e-10  # of noise, by the largest measurement
_ITERATIONS = 30
_SETTLED = 1e-2  # change of base parameters by their standard deviations, and of noise levels by themselves
_PROBES = 8  # random vectors that estimate traces
_OFFSET = 0.1  # [rad, m] standard deviation of joint offsets before anything is measured
_FACTOR = 2.0  # standard deviation of the logarithm of a friction speed before anything is measured
_TOLD = 0.5  # with which a log tells it, at the file's; else it stays there
_STRIDE = 1.0  # it changes by in one iteration, at most: the torque turns too fast for longer steps
_WIDE = 30.0  # that of a base parameter by the largest of its unit


class Measurements(NamedTuple):
    """What was measured at K times.

    Parameters
    ----------
    t : ndarray, shape (K,)
        [s].
    motion : tuple of (ndarray of shape (K, n) or None)
        Positions, velocities and accelerations of the independent coordinates.
    u : ndarray, shape (K, nu)
        Controls.
    """

    t: Array
    motion: tuple[Array, Array | None, Array | None]
    u: Array

    def part(self, chosen: slice) -> Measurements:
        """Some of the samples."""
        q, v, a = (each if each is None else each[chosen] for each in self.motion)
        assert q is not None
        return Measurements(self.t[chosen], (q, v, a), self.u[chosen])


class MaximumLikelihood(NamedTuple):
    """Maximum-likelihood estimate.

    Parameters
    ----------
    beta, covariance : ndarray, shapes (rank,), (rank, rank)
        Base parameters.
    speeds, speed_sd, file_speeds : ndarray, shape (m,)
        Friction speeds that were unknown, and what the file says [rad/s, m/s].
    offsets, offset_sd : ndarray, shape (n,)
        Joint offsets [rad, m], zero where they are known.
    torque_noise, position_noise : ndarray, shape (n,)
        Standard deviations [N m, N; rad, m].
    residuals : ndarray, shape (K, n)
        Measured less modelled torques.
    motion : JointMotion
    correlation : ndarray, shape (n,)
        By what the variance of a mean of torque residuals exceeds that of independent ones.
    settled : bool
        Whether parameters and noise levels stayed in the end.
    dynamics : InverseDynamics
        With these friction speeds.
    """

    beta: Array
    covariance: Array
    speeds: Array
    speed_sd: Array
    file_speeds: Array
    offsets: Array
    offset_sd: Array
    torque_noise: Array
    position_noise: Array
    residuals: Array
    motion: JointMotion
    correlation: Array
    settled: bool
    dynamics: InverseDynamics


def spline_basis(t: Array, count: int) -> tuple[csr_matrix, csr_matrix, csr_matrix]:
    """Values, first and second derivatives of `count` splines at times, each shape (K, count)."""
    ends = np.linspace(t[0], t[-1], count - DEGREE + 1)
    knots = np.concatenate([[t[0]] * DEGREE, ends, [t[-1]] * DEGREE])
    found, differences, degree = [], eye(count, format="csr"), DEGREE
    for _ in range(3):
        found.append(BSpline.design_matrix(t, knots, degree) @ differences)
        width = knots[degree + 1 : -1] - knots[1 : -degree - 1]
        size = len(width)
        step = diags([-degree / width, degree / width], [0, 1], shape=(size, size + 1))
        differences, knots, degree = (step @ differences).tocsr(), knots[1:-1], degree - 1
    return found[0].tocsr(), found[1].tocsr(), found[2].tocsr()


def smooth(data: Measurements, count: int) -> tuple[Array, Array, Array, Array]:
    """Splines through measured positions: their values, two derivatives and residuals, each shape (K, n)."""
    B = spline_basis(data.t, count)
    gram = _bands((B[0].T @ B[0] + 1e-12 * eye(count)).tocsr(), DEGREE)
    c = cho_solve_banded((cholesky_banded(gram, lower=True), True), B[0].T @ data.motion[0])
    y, yd, ydd = (basis @ c for basis in B)
    return y, yd, ydd, data.motion[0] - y


def knots_for(data: Measurements) -> int:
    """Number of splines that positions ask for (Schwarz 1978)."""
    K, best, found = len(data.t), np.inf, 0
    scale = np.abs(data.motion[0]).max()
    for spacing in (60, 40, 28, 20, 14, 10, 7, 5, 4):
        count = max(K // spacing, 2) + DEGREE
        if count >= K // 3:
            break
        rest = smooth(data, count)[3]
        size = np.maximum((rest**2).mean(axis=0), (_FLOOR * scale) ** 2)
        criterion = K * np.log(size).mean() + count * np.log(K)
        if criterion < best:
            best, found = criterion, count
    return found or max(K // 4, DEGREE + 1)


class Fit:
    """Gauss and Newton's method for one log and one number of splines.

    The joints in a column of `turning`, shape (nv, m), have one friction speed, which is unknown. It is found
    if it is `told`, shape (m,).
    """

    def __init__(
        self,
        dynamics: InverseDynamics,
        unknowns: Unknowns,
        base: BaseParameters,
        data: Measurements,
        count: int,
        *,
        offsets: bool,
        turning: Array,
        told: Array,
    ) -> None:
        self.unknowns, self.base, self.data = unknowns, base, data
        self.n, self.count, self.finds_offsets = dynamics.n, count, offsets
        self.B = [kron(basis, eye(self.n), format="csr") for basis in spline_basis(data.t, count)]
        self.turning, self.found_turning = turning, turning * told
        self.file_beta, beta_sd = beliefs(unknowns, base)
        others = turning.shape[1], self.n * offsets
        speeds = self._mean(np.log(dynamics.speeds))
        self.believed = np.concatenate([self.file_beta, speeds, np.zeros(others[1])])
        self.prior = np.concatenate([beta_sd, np.repeat([_FACTOR, _OFFSET], others)]) ** -2.0
        self.probes = np.random.default_rng(1).choice([-1.0, 1.0], (_PROBES, self._rows))

    def _mean(self, values: Array) -> Array:
        """Means over the joints of each unknown friction speed."""
        return np.asarray(values @ self.turning / self.turning.sum(axis=0))

    @property
    def _orders(self) -> list[int]:
        return [order for order, values in enumerate(self.data.motion) if values is not None]

    @property
    def _rows(self) -> int:
        return (len(self._orders) + 1) * len(self.data.t) * self.n

    def values_of(self, beta: Array) -> Array:
        """All parameters of the dynamics with these base parameters: nearest to the file's."""
        unknowns, C = self.unknowns, self.base.combinations
        size = np.maximum(np.abs(unknowns.values), 1e-3)
        lift = size[:, None] ** 2 * C.T
        change = lift @ np.linalg.solve(C @ lift, beta - self.file_beta)
        return np.asarray(unknowns.known + unknowns.shares @ (unknowns.values + change))

    def tells(self, near: Array, dynamics: InverseDynamics) -> Array:
        """Which friction speeds the log tells, by the deviations at those of the dynamics, shape (m,)."""
        c, p, near = self._start(near, dynamics)
        r, A_c, A_p, _, _ = self._linearise(c, p, near, dynamics)
        spread = self._spread(self._noise(r, np.zeros(len(r))), np.ones(self.n))
        _, covariance = self._factorise(A_c, A_p, spread, self.prior)
        return np.asarray(np.sqrt(np.diag(covariance))[self._speeds] < _TOLD)

    @property
    def _speeds(self) -> slice:
        """Where the logarithms of friction speeds stand in the parameters."""
        return slice(self.base.rank, self.base.rank + self.turning.shape[1])

    def _start(self, near: Array, dynamics: InverseDynamics) -> tuple[Array, Array, Array]:
        """Spline through the positions, and parameters by weighted regression along it."""
        y, yd, ydd, _ = smooth(self.data, self.count)
        normal = _bands((self.B[0].T @ self.B[0]).tocsr(), (DEGREE + 1) * self.n - 1)
        c = cho_solve_banded((cholesky_banded(normal, lower=True), True), self.B[0].T @ y.ravel())
        motion = dynamics.motion(y, yd, ydd, near)
        p = self.believed.copy()
        p[: self.base.rank] = regression(dynamics, self.unknowns, self.base, motion, self.data.u)
        p[self._speeds] = self._mean(np.log(dynamics.speeds))
        return c, p, motion.qs

    def run(self, near: Array, dynamics: InverseDynamics) -> MaximumLikelihood:
        """Iterate until parameters and noise levels stay.

        Parameters
        ----------
        near : ndarray, shape (K, nq)
            Configurations near those of the log.
        dynamics : InverseDynamics
            Its friction speeds are those to begin with.
        """
        c, p, near = self._start(near, dynamics)
        rank, logs = self.base.rank, self._speeds
        known = logs.stop
        noise, correlation, settled = np.zeros(0), np.ones(self.n), False
        for _ in range(_ITERATIONS):
            r, A_c, A_p, motion, tau = self._linearise(c, p, near, dynamics)
            near = motion.qs
            if not len(noise):
                noise = self._noise(r, np.zeros(len(r)))
            spread = self._spread(noise, correlation)
            solve, covariance = self._factorise(A_c, A_p, spread, self.prior)
            weighted = r / spread**2
            dc, dp = solve(A_c.T @ weighted, A_p.T @ weighted + self.prior * (self.believed - p))
            if not np.isfinite(dp).all():
                raise InvalidValue("log", "motions that do not tell the parameters", "more or faster ones")
            dp[logs] = np.clip(dp[logs], -_STRIDE, _STRIDE)
            c, p = c + dc, p + dp
            found = np.exp(self.turning @ p[logs])
            dynamics = dynamics.with_speeds(np.where(self.found_turning.any(axis=1), found, dynamics.speeds))
            left = r - A_c @ dc - A_p @ dp
            before, noise = noise, self._noise(left, self._freedom(A_c, A_p, spread, solve))
            correlation = _correlation(left[-tau.size :].reshape(tau.shape))
            moved = np.abs(dp[:known]) / np.sqrt(np.diag(covariance)[:known])
            if moved.max() < _SETTLED and np.abs(noise / before - 1.0).max() < _SETTLED:
                settled = True
                break
        levels = noise.reshape(-1, self.n)
        sd = np.sqrt(np.diag(covariance))
        delta, delta_sd = (p[known:], sd[known:]) if self.finds_offsets else np.zeros((2, self.n))
        speeds = np.exp(p[logs])
        return MaximumLikelihood(
            p[:rank],
            covariance[:rank, :rank],
            speeds,
            speeds * sd[logs],
            np.exp(self.believed[logs]),
            delta,
            delta_sd,
            levels[-1],
            levels[0],
            left[-tau.size :].reshape(tau.shape),
            motion,
            correlation,
            settled,
            dynamics,
        )

    def _linearise(
        self, c: Array, p: Array, near: Array, dynamics: InverseDynamics
    ) -> tuple[Array, csr_matrix, Array, JointMotion, Array]:
        """Residuals, and what the model's values change by: in c (sparse) and in parameters."""
        data, K, n, rank = self.data, len(self.data.t), self.n, self.base.rank
        y, yd, ydd = ((B @ c).reshape(K, n) for B in self.B)
        motion = dynamics.motion(y, yd, ydd, near)
        full = dynamics.regressor(motion)
        columns = (full @ self.unknowns.shares)[:, :, self.base.chosen]
        tau = dynamics.compute_applied_torques(motion, data.u)
        values = self.values_of(p[:rank])
        slopes = dynamics.slopes(motion, values, data.u)
        blocks, at = (np.arange(K), np.arange(K + 1))
        torque_c = sum(
            bsr_matrix((slope, blocks, at), shape=(K * n, K * n)) @ B
            for slope, B in zip(slopes, self.B, strict=True)
        )
        residuals, rows, borders = [], [], []
        for order in self._orders:
            measured = data.motion[order]
            assert measured is not None
            model, border = (y, yd, ydd)[order], np.zeros((K * n, len(p)))
            if order == 0 and self.finds_offsets:
                model = model - p[-n:]
                border[:, -n:] = -np.tile(np.eye(n), (K, 1))
            residuals.append((measured - model).ravel())
            rows.append(self.B[order])
            borders.append(border)
        residuals.append((tau - full @ values).ravel())
        rows.append(torque_c)
        last = np.zeros_like(borders[0])
        last[:, :rank] = columns.reshape(K * n, -1)
        turns = dynamics.speed_slopes(motion, values) @ self.found_turning
        last[:, self._speeds] = turns.reshape(K * n, turns.shape[2])
        borders.append(last)
        return np.concatenate(residuals), vstack(rows, format="csr"), np.vstack(borders), motion, tau

    def _groups(self, values: Array) -> Array:
        """Sums over samples for each kind of measurement and coordinate."""
        return np.asarray(values.reshape(-1, len(self.data.t), self.n).sum(axis=1).ravel())

    def _noise(self, residuals: Array, freedom: Array) -> Array:
        if not freedom.any():
            freedom = np.zeros(len(residuals) // len(self.data.t))
        left = np.maximum(len(self.data.t) - freedom, 1.0)
        floors = [np.abs(values).max() for values in self.data.motion if values is not None]
        floors.append(np.abs(self.data.u).max())
        floor = np.repeat(_FLOOR * np.maximum(floors, 1e-6), self.n)
        return np.asarray(np.maximum(np.sqrt(self._groups(residuals**2) / left), floor))

    def _spread(self, noise: Array, correlation: Array) -> Array:
        levels = noise.reshape(-1, 1, self.n).copy()
        levels[-1] *= np.sqrt(correlation)
        return np.broadcast_to(levels, (len(levels), len(self.data.t), self.n)).ravel()

    def _factorise(self, A_c: csr_matrix, A_p: Array, spread: Array, prior: Array):  # type: ignore[no-untyped-def]
        weighted = diags(spread**-2.0) @ A_c
        band = _bands((A_c.T @ weighted).tocsr(), (DEGREE + 1) * self.n - 1)
        band[0] *= 1.0 + 1e-13
        factor = cholesky_banded(band, lower=True)
        border = weighted.T @ A_p
        inner = cho_solve_banded((factor, True), border)
        size = np.sqrt(prior)
        schur = A_p.T @ (A_p / spread[:, None] ** 2) - border.T @ inner + np.diag(prior)
        size = np.sqrt(np.diag(schur))
        outer = cho_factor(schur / np.outer(size, size))
        covariance = cho_solve(outer, np.eye(len(size))) / np.outer(size, size)

        def solve(right_c: Array, right_p: Array) -> tuple[Array, Array]:
            first = cho_solve_banded((factor, True), right_c)
            p = cho_solve(outer, (right_p - border.T @ first) / size) / size
            return first - inner @ p, p

        return solve, covariance

    def _freedom(self, A_c: csr_matrix, A_p: Array, spread: Array, solve) -> Array:  # type: ignore[no-untyped-def]
        """Parameters that each kind of measurement determines: traces by random vectors (Hutchinson)."""
        found = np.zeros(self._rows // len(self.data.t))
        for probe in self.probes:
            z = probe / spread
            c, p = solve(A_c.T @ z, A_p.T @ z)
            found += self._groups(probe * (A_c @ c + A_p @ p) / spread) / len(self.probes)
        return np.clip(found, 0.0, 0.9 * len(self.data.t))


def beliefs(unknowns: Unknowns, base: BaseParameters) -> tuple[Array, Array]:
    """The file's base parameters, and by how much they may be wrong: more than any robot's are."""
    beta, units = base.combinations @ unknowns.values, [base.labels[k].unit for k in base.chosen]
    largest = {unit: max(np.abs(beta[[u == unit for u in units]]).max(), 1.0) for unit in units}
    return beta, _WIDE * np.array([largest[unit] for unit in units])


def regression(
    dynamics: InverseDynamics, unknowns: Unknowns, base: BaseParameters, motion: JointMotion, u: Array
) -> Array:
    """Base parameters by least squares along a motion that is taken for true."""
    full = dynamics.regressor(motion)
    columns = (full @ unknowns.shares)[:, :, base.chosen]
    torques = dynamics.compute_applied_torques(motion, u) - full @ unknowns.known
    weights, (believed, sd) = np.ones(dynamics.n), beliefs(unknowns, base)
    for _ in range(2):
        A = np.vstack([(columns * weights[:, None]).reshape(-1, base.rank), np.diag(1.0 / sd)])
        size = np.linalg.norm(A, axis=0)
        right = np.concatenate([(torques * weights).ravel(), believed / sd])
        beta = lstsq(A / size, right, cond=1e-12, lapack_driver="gelsy")[0] / size
        rest = torques - columns @ beta
        weights = 1.0 / np.maximum(rest.std(axis=0), 1e-9 * np.abs(torques).max() + 1e-300)
    return np.asarray(beta)


def _bands(matrix: csr_matrix, width: int) -> Array:
    """Lower bands of a symmetric matrix."""
    size = matrix.shape[0]
    found = np.zeros((min(width, size - 1) + 1, size))
    for k in range(len(found)):
        found[k, : size - k] = matrix.diagonal(-k)
    return found


def _correlation(residuals: Array) -> Array:
    """1 + 2 times the correlations of neighbours, as far as they are more than chance; at least 1."""
    K, n = residuals.shape
    found = np.ones(n)
    for j, column in enumerate(residuals.T):
        size = float(column @ column) or 1.0
        for lag in range(1, K // 10):
            part = float(column[lag:] @ column[:-lag]) / size
            if part < 2.0 / np.sqrt(K):
                break
            found[j] += 2.0 * part
    return found


def estimate(
    dynamics: InverseDynamics,
    unknowns: Unknowns,
    base: BaseParameters,
    data: Measurements,
    *,
    turning: Array,
    offsets: bool = False,
) -> MaximumLikelihood:
    """Fit with half as many splines again as positions ask for, and more where torques ask for them."""
    K = len(data.t)
    most = max(K // 3, DEGREE + 1)
    count = min(3 * knots_for(data) // 2, most)
    near = dynamics.follow(smooth(data, count)[0])

    def fit(count: int, told: Array) -> Fit:
        return Fit(dynamics, unknowns, base, data, count, offsets=offsets, turning=turning, told=told)

    told = np.ones(turning.shape[1], dtype=bool)
    if len(told):
        told = fit(count, told).tells(near, dynamics)
    best = fit(count, told).run(near, dynamics)
    while count < most:
        count = min(3 * count // 2, most)
        finer = fit(count, told).run(best.motion.qs, best.dynamics)
        gain = K * np.log(best.torque_noise / finer.torque_noise).sum()
        if gain < 0.05 * K * dynamics.n:
            break
        best = finer
    return best
