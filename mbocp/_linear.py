"""Linear algebra that several layers need alike."""

from __future__ import annotations

import math

import numpy as np

from mbocp._arrays import Array

__all__ = ["norm", "null_space"]

_SMALL = 1e-150  # squares of what is smaller lose their digits


def null_space(matrix: Array, tolerance: float) -> Array:
    """Return an orthonormal basis of the null space, as columns.

    Parameters
    ----------
    matrix : ndarray, shape (m, n)
    tolerance : float
        Singular values up to this multiple of the largest one, or of 1 if that is larger, count as zero.
        (`scipy.linalg.null_space` has no such floor: it finds a rank in a matrix of round-off.)

    Returns
    -------
    basis : ndarray, shape (n, n - rank)
    """
    rows, columns = matrix.shape
    # A tall matrix has a large left factor that nobody needs; its triangle has the same null space.
    triangle: Array = np.asarray(np.linalg.qr(matrix, mode="r")) if rows > columns else matrix
    _, singular, vt = np.linalg.svd(triangle)
    rank = int(np.count_nonzero(singular > tolerance * max(singular.max(initial=0.0), 1.0)))
    basis: Array = vt[rank:].T
    return basis


def norm(vector: Array) -> float:
    """Return the Euclidean norm of a vector, shape (n,), also where squares of entries have no number.

    An iterate that runs away is no error of arithmetic: its norm is a large number, or infinite.
    """
    with np.errstate(over="ignore"):
        size = float(np.linalg.norm(vector))
    has_no_squares = math.isinf(size) or (size < _SMALL and vector.any())
    return math.hypot(*vector.tolist()) if has_no_squares else size
