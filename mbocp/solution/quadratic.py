"""Convex quadratic programmes by Mehrotra's predictor and corrector, with sparse matrices.

References
----------
Mehrotra, "On the implementation of a primal-dual interior point method", 1992.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from mbocp._arrays import Array

_MOST_ITERATIONS = 40  # three times as many as programmes take that have a solution
_EXACT = 1e-11  # of rows, whose sizes are about one
_COMPLEMENTARY = 1e-10  # of slacks and multipliers
_INSIDE = 0.995  # of the way to the next limit
_FIRST = 0.1  # slack at the start
_LEAST = 1e-300
_GROWN = 1e18  # multipliers, of a linear part of about one, where there is no solution


def minimise(
    weights: Array, linear: Array, equations: tuple[Any, Array], rows: tuple[Any, Array]
) -> Array | None:
    """Minimise x' diag(weights) x / 2 + linear' x, where A x = b and G x <= h.

    Parameters
    ----------
    weights, linear : ndarray, shape (n,)
        Weights 0 or above.
    equations, rows : tuple of sparse matrix and ndarray
        A and b, G and h; with entries of about one.

    Returns
    -------
    x : ndarray, shape (n,), optional
        None if there is none, or it is not found.
    """
    (A, b), (G, h) = ((matrix.tocsr(), right) for matrix, right in (equations, rows))
    size = max(float(weights.max()), _LEAST)
    P, g, A_t, G_t = weights / size, linear / size, A.T.tocsr(), G.T.tocsr()
    factorise, n = _factoriser(P, A, G), len(linear)
    y, s, z = np.zeros(len(b)), np.ones(len(h)), np.full(len(h), max(float(np.abs(g).max()), _FIRST))
    try:
        x = factorise(s)(np.concatenate([G_t @ h - g, b]))[:n]
        s = np.maximum(h - G @ x, _FIRST)
        for _ in range(_MOST_ITERATIONS):
            of_x, of_s, of_b = P * x + g + G_t @ z + A_t @ y, G @ x + s - h, A @ x - b
            if max(np.abs(of_s).max(), np.abs(of_b).max()) < _EXACT and s @ z < _COMPLEMENTARY * len(h):
                return np.asarray(x)
            step = partial(_step, factorise(z / s), (G, G_t), (s, z), (of_x, of_s, of_b))
            _, _, ds, dz = step(s * z)
            left = (s + _length(s, ds) * ds) @ (z + _length(z, dz) * dz) / (s @ z)
            dx, dy, ds, dz = step(s * z + ds * dz - left**3 * (s @ z) / len(h))
            primal, dual = (_INSIDE * _length(one, change) for one, change in ((s, ds), (z, dz)))
            x, s, y, z = x + primal * dx, s + primal * ds, y + dual * dy, z + dual * dz
            if not z.max() < _GROWN:
                return None
    except RuntimeError:  # singular: multipliers grow without end where there is none
        return None
    return None


def _factoriser(weights: Array, A: Any, G: Any) -> Callable[[Array], Callable[[Array], Array]]:
    """Factorise [[diag(weights) + G' diag(w) G, A'], [A, 0]] for any w: its places are found once."""
    from scipy.sparse import csc_matrix  # slow to import, and no solve wants it
    from scipy.sparse.linalg import splu

    n, size = G.shape[1], G.shape[1] + A.shape[0]
    counts = np.diff(G.indptr)
    of_row = np.repeat(np.arange(len(counts)), counts)
    one = np.repeat(np.arange(len(of_row)), counts[of_row])  # pairs of entries of a row
    other = np.arange(len(one)) - np.repeat(np.cumsum(counts[of_row]) - counts[of_row], counts[of_row])
    other += G.indptr[of_row[one]]
    of_A = A.tocoo()
    down, right = np.arange(n), n + of_A.row
    places = np.concatenate([down, right, of_A.col, G.indices[one]]) * size + np.concatenate(
        [down, of_A.col, right, G.indices[other]]
    )
    found, at = np.unique(places, return_inverse=True)
    starts = np.searchsorted(found, size * np.arange(size + 1))
    fixed, products = np.concatenate([weights, of_A.data, of_A.data]), G.data[one] * G.data[other]

    def factorise(w: Array) -> Callable[[Array], Array]:
        entries = np.bincount(at, np.concatenate([fixed, products * w[of_row[one]]]), len(found))
        solve: Callable[[Array], Array] = splu(
            csc_matrix((entries, found % size, starts), (size, size))
        ).solve
        return solve

    return factorise


def _step(
    solve: Callable[[Array], Array],
    rows: tuple[Any, Any],
    slack: tuple[Array, Array],
    left: tuple[Array, Array, Array],
    products: Array,
) -> tuple[Array, Array, Array, Array]:
    """Changes of x, y, s and z that leave nothing, and take products of s and z away, to first order."""
    (G, G_t), (s, z), (of_x, of_s, of_b) = rows, slack, left
    found = solve(np.concatenate([-of_x - G_t @ ((z * of_s - products) / s), -of_b]))
    dx, dy = np.split(found, [len(of_x)])
    ds = -of_s - G @ dx
    return dx, dy, ds, -(products + z * ds) / s


def _length(values: Array, moves: Array) -> float:
    """Largest part of moves, up to all, that leaves values above 0."""
    return 1.0 / max(1.0, float((-moves / values).max()))
