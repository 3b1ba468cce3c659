"""Samples in an estimator's horizon, and the Kalman filter for those that leave it, by square roots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.receding.estimator_functions import NUM_MOMENTS, EstimatorLayout
from mbocp.robot import Robot
from mbocp.robot.kinematics import difference

if TYPE_CHECKING:
    from mbocp._native._kernel import StageFunction
    from mbocp.receding.estimator_functions import EstimatorLayout

FIRST = 2  # stages before the steps
_ROUND_OFF = 1e-6  # of the length of a step


class Samples:
    """Moments of the samples in each step, however many there are.

    Parameters
    ----------
    robot : Robot
    layout : EstimatorLayout
    steps : int
    weights : mapping of str to ndarray, shapes (nv,)
        Inverse variances of `q` and, if it is measured, `v`.

    Attributes
    ----------
    rows : ndarray, shape (FIRST + steps, num_rho)
        Parameters of all stages, the newest step last.
    """

    def __init__(
        self, robot: Robot, layout: EstimatorLayout, steps: int, weights: Mapping[str, Array]
    ) -> None:
        self._robot, self._weights, self._reference = robot, weights, layout.rho["reference"]
        self.rows = np.zeros((FIRST + steps, layout.num_rho))
        self.rows[:FIRST, layout.rho["arrives"]] = np.eye(FIRST)
        self.rows[:, self._reference] = robot.q0
        self._newest = {name: self.rows[-1, where] for name, where in layout.rho.items()}

    def has_room(self, dt: float, step: float) -> bool:
        """Return whether so much time fits into the newest step; a new one takes any."""
        h = float(self._newest["h"][0])
        return h == 0.0 or h + dt <= (1.0 + _ROUND_OFF) * step

    def begin_step(self) -> None:
        """Leave out the oldest step for a new one."""
        self.rows[FIRST:-1] = self.rows[FIRST + 1 :]
        self.rows[-1] = 0.0

    def forget(self) -> None:
        """Leave out all samples."""
        self.rows[FIRST:] = 0.0
        self.rows[FIRST:, self._reference] = self._robot.q0

    def add(self, sample: Mapping[str, Array], u: Array, dt: float, q_last: Array) -> None:
        """Make the newest step longer by the time to a sample, and add the sample, if it is not lost.

        Parameters
        ----------
        sample : mapping of str to ndarray
            `q` and, if it is measured, `v`; empty: it was lost.
        u : ndarray, shape (nu,)
            Controls since the sample before.
        dt : float
            Time since then [s].
        q_last : ndarray, shape (nq,)
            Configuration at the newest node, about which a step takes its samples.
        """
        row = self._newest
        before = float(row["h"][0])
        t = before + dt
        if before == 0.0:
            row["reference"][:] = q_last
        row["h"][0], row["rate"][0], row["moves"][0] = t, 1.0 / t, 1.0
        row["u"][:] = (before * row["u"] + dt * u) / t
        if not sample:
            return
        row["moments"] += t ** np.arange(NUM_MOMENTS)
        off = {**sample, "q": difference(self._robot.model, row["reference"], sample["q"])}
        for key, powers in (("q", (1.0, t, t * t / 2)), ("v", (1.0, t))):
            if key in off:
                row[f"of_{key}"] += np.outer(powers, off[key]).ravel()
                row["squares"] += self._weights[key] @ off[key] ** 2 / 2


@dataclass(frozen=True, eq=False)
class LinearStage:
    """A stage about its nodes: rows, cost and derivatives as numbers.

    Attributes
    ----------
    c : ndarray, shape (ndx,)
    slopes : ndarray, shape (ndx, 2 ndx + nw)
        Of c in the state after the stage, that before it, and the noise.
    gradient, hessian : ndarray, shapes (2 ndx,), (2 ndx, 2 ndx)
        Of the cost of samples in both states.
    w : ndarray, shape (nw,)
        The noise at which they are taken.
    """

    c: Array
    slopes: Array
    gradient: Array
    hessian: Array
    w: Array

    @classmethod
    def at(
        cls,
        linear: StageFunction,
        layout: EstimatorLayout,
        theta: Array,
        x0: Array,
        x1: Array,
        w: Array,
        rho: Array,
    ) -> LinearStage:
        """Evaluate the function `linear` of `estimator_functions`."""
        n, size = layout.ndx, 2 * layout.ndx + layout.nw
        c, slopes, gradient, hessian = linear.evaluate([x0, x1, w, theta, rho], 1, False)
        of_states = slice(0, 2 * n)
        square = hessian.reshape(size, size)[of_states, of_states]  # CasADi stores matrices by columns
        return cls(c, slopes.reshape(size, n).T, gradient[of_states], square, w)

    def filter(self, mean: Array, root: Array) -> tuple[Array, Array]:
        """Mean, and a root R of the covariance R'R, of the state after the stage, given its samples.

        Parameters
        ----------
        mean : ndarray, shape (ndx,)
            Of the state before it, from the node.
        root : ndarray, shape (ndx, ndx)
            L of its covariance L L'.
        """
        n, nw = len(self.c), len(self.w)
        answer = -np.linalg.solve(self.slopes[:, :n], np.column_stack([self.slopes[:, n:], self.c]))
        T, offset = answer[:, :-1], answer[:, -1]
        S = np.eye(n + nw)
        S[:n, :n] = root
        G = np.vstack([T @ S, S[:n]])  # of both states, in noise of unit variance
        z = np.concatenate([T @ np.concatenate([mean, -self.w]) + offset, mean])
        L = np.linalg.cholesky(np.eye(n + nw) + G.T @ self.hessian @ G)
        both = np.linalg.solve(L, np.column_stack([G[:n].T, -G.T @ (self.hessian @ z + self.gradient)]))
        columns = both[:, :-1]
        return z[:n] + columns.T @ both[:, -1], columns


def lower_root(columns: Array) -> Array:
    """Lower triangle L with L L' = R'R."""
    return np.asarray(np.linalg.qr(columns, mode="r")).T


def filter_stage(stage: Callable[[], LinearStage], mean: Array, root: Array) -> tuple[Array, Array]:
    """Mean and root after a stage; NaN where its functions are not finite or its steps have no solution."""
    try:
        return stage().filter(mean, root)
    except (np.linalg.LinAlgError, RuntimeError):
        return np.full_like(mean, np.nan), np.full_like(root, np.nan)
