"""A Kalman filter's step through a stage of an estimator, by square roots of covariances."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, dataclass

if TYPE_CHECKING:
    from mbocp._native._kernel import StageFunction
    from mbocp.receding.estimator_functions import EstimatorLayout


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
