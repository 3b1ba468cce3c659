"""Whether multipliers exist: equality ones of any sign, those of active inequalities not negative.

The multipliers come from a least-squares problem of the whole system, which stays well conditioned where the
gradient condensed onto the controls does not: dynamics that amplify a million times over the horizon condense
into a matrix of condition 1e18. Limits are active where the motion touches them. Where touching does not
decide (a weak multiplier), those that the solution claims for its limits are taken as they are: any that
have the right signs, act only where the motion touches, and leave nothing over, prove the condition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.optimize import lsq_linear
from scipy.sparse.linalg import splu

from tests.checker.conditions import Bound, Conditions
from tests.checker.system import Array

__all__ = ["Stationarity", "stationarity"]

_TOUCHED = 1e-6  # of a limit's size
_NEAR = 1e-4  # of a limit's size: may have a multiplier of a barrier that is not quite zero
_FLAT = 1e-9  # a gradient that pushes nowhere, as in the middle of a tube
_ROUNDS = 6
_REGULAR = 1e-13  # on multipliers of rows of norm one: dependent rows share
_REFINEMENTS = 30  # enough where a singular value is above 2e-7
_GOOD = 1e-6  # left over: no need to ask for other multipliers


@dataclass(frozen=True)
class Stationarity:
    """What is left of the gradient, relative to the terms that cancel; and by whose multipliers.

    Attributes
    ----------
    residual : float
    complementarity : float
        Largest multiplier times distance from its limit, relative to the cost.
    source : str
        "own", "claimed" or "signed" multipliers of the limits.
    active : int
    """

    residual: float
    complementarity: float
    source: str
    active: int


class _Projection:
    """min |g + K' y|, with rows of norm one."""

    def __init__(self, K: sparse.csr_matrix) -> None:
        norms = np.sqrt(np.asarray(K.multiply(K).sum(axis=1)).ravel())
        self.norms = np.where(norms > 0.0, norms, 1.0)
        self.K = sparse.diags(1.0 / self.norms) @ K
        n, m = K.shape[1], K.shape[0]
        matrix = sparse.bmat([[sparse.eye(n), self.K.T], [self.K, -_REGULAR * sparse.eye(m)]], format="csc")
        self.lu, self.n = splu(matrix), n

    def __call__(self, g: Array) -> tuple[Array, Array]:
        """What is left, and y.

        One solve leaves the part d / (s^2 + d) along a singular value s of K, d being `_REGULAR`; unstable
        dynamics have values where that is much. So the rest is projected again for as long as it shrinks.
        """
        y, left = np.zeros(self.K.shape[0]), g
        for _ in range(_REFINEMENTS):
            found = self.lu.solve(np.concatenate([-left, np.zeros(y.size)]))
            better = y + found[self.n :]
            rest = g + self.K.T @ better
            if not np.linalg.norm(rest) < np.linalg.norm(left):
                break
            y, left = better, rest
        return left, y


def _matrix(bounds: list[Bound], size: int, scales: Array) -> sparse.csr_matrix:
    if not bounds:
        return sparse.csr_matrix((0, size))
    i = np.concatenate([np.full(b.columns.size, k) for k, b in enumerate(bounds)])
    j = np.concatenate([b.columns for b in bounds])
    values = np.concatenate([b.gradient for b in bounds]) * scales[j]
    return sparse.csr_matrix((values, (i, j)), shape=(len(bounds), size))


def stationarity(conditions: Conditions) -> Stationarity:
    c = conditions
    K = (c.K @ sparse.diags(c.scales)).tocsr()
    g = c.scales * c.gradient
    active = [b for b in c.bounds if b.value > -_TOUCHED * b.scale]
    own = _own(K, g, c, active)
    if own.residual < _GOOD or not c.bounds:
        return own
    found = min(own, _claimed(K, g, c), key=lambda one: one.residual)
    if found.residual < _GOOD:
        return found
    signed = _signed(K, g, c)
    return signed if signed.residual < found.residual else found


def _signed(K: sparse.csr_matrix, g: Array, c: Conditions) -> Stationarity:
    """Least squares over multipliers of one sign of all limits that are near; their distances count."""
    near = [b for b in c.bounds if b.value > -_NEAR * b.scale and np.abs(b.gradient).max() > _FLAT]
    A = _matrix(near, g.size, c.scales)
    norms = np.sqrt(np.asarray(A.multiply(A).sum(axis=1)).ravel())
    rows = (sparse.diags(1.0 / norms) @ A).toarray()
    projection = _Projection(K)
    across = np.array([projection(row)[0] for row in rows]).reshape(len(near), g.size)
    decided = np.abs(across).max(axis=1, initial=0.0) < _FLAT  # by the equations alone
    near = [b for b, is_decided in zip(near, decided, strict=True) if not is_decided]
    rows, norms, across = rows[~decided], norms[~decided], across[~decided]
    lam = lsq_linear(across.T, -projection(g)[0], (0.0, np.inf), method="bvls").x if near else np.zeros(0)
    left, y = projection(g + rows.T @ lam)
    matrix, every = sparse.vstack([projection.K, sparse.csr_matrix(rows)], format="csr"), np.append(y, lam)
    slack = sum(value * max(-b.value, 0.0) for value, b in zip(lam / norms, near, strict=True))
    gap = slack / max(abs(c.cost), 1e-300)
    return Stationarity(_relative(left, matrix, every, g, c.kinds), gap, "signed", int((lam > 0.0).sum()))


def _own(K: sparse.csr_matrix, g: Array, c: Conditions, active: list[Bound]) -> Stationarity:
    """Least squares, leaving out limits whose multiplier comes out negative."""
    best = None
    for _ in range(_ROUNDS):
        A = _matrix(active, g.size, c.scales)
        projection = _Projection(sparse.vstack([K, A], format="csr"))
        left, y = projection(g)
        lam = y[K.shape[0] :]
        matrix = projection.K
        negative = lam < -1e-9 * max(float(np.abs(lam).max(initial=0.0)), 1e-300)
        relative = _relative(left, matrix, y, g, c.kinds)
        worst = float(-lam.min(initial=0.0)) / max(_size(matrix, y, g), 1e-300)
        best = Stationarity(max(relative, worst), 0.0, "own", len(active))
        if not negative.any():
            return best
        active = [b for b, bad in zip(active, negative, strict=True) if not bad]
    assert best is not None
    return best


def _claimed(K: sparse.csr_matrix, g: Array, c: Conditions) -> Stationarity:
    """The multipliers that are claimed; touched limits of which nothing is known have those that fit best."""
    bounds = [b for b in c.bounds if b.claimed > 0.0]
    unknown = [b for b in c.bounds if np.isnan(b.claimed) and b.value > -_TOUCHED * b.scale]
    A = _matrix(bounds, g.size, c.scales)
    lam = np.array([b.claimed for b in bounds])
    pushed = g + A.T @ lam if bounds else g
    projection = _Projection(sparse.vstack([K, _matrix(unknown, g.size, c.scales)], format="csr"))
    left, y = projection(pushed)
    matrix = sparse.vstack([projection.K, A], format="csr")
    every = np.concatenate([y, lam])
    relative = _relative(left, matrix, every, g, c.kinds)
    worst = float(-y[K.shape[0] :].min(initial=0.0)) / max(_size(matrix, every, g), 1e-300)
    slack = sum(b.claimed * max(-b.value, 0.0) for b in bounds)
    found = max(relative, worst)
    return Stationarity(found, slack / max(abs(c.cost), 1e-300), "claimed", len(bounds) + len(unknown))


def _size(K: sparse.csr_matrix, y: Array, g: Array) -> float:
    return float((np.abs(g) + np.abs(K).T @ np.abs(y)).max())


def _relative(left: Array, K: sparse.csr_matrix, y: Array, g: Array, kinds: Array) -> float:
    """Largest remainder of each kind of unknown over the largest sum of terms of that kind."""
    terms = np.abs(g) + np.abs(K).T @ np.abs(y)
    found = 0.0
    for kind in range(5):
        chosen = kinds == kind
        if chosen.any():
            found = max(found, float(np.abs(left[chosen]).max()) / max(float(terms[chosen].max()), 1e-300))
    return found
