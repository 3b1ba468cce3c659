"""Linear algebra that several layers need alike."""

from __future__ import annotations

import math

import numpy as np

from mbocp._arrays import Array

_SMALL = 1e-150  # squares of what is smaller lose their digits
_TIE = 0.99  # rows, and entries, from this part of the largest on count as equally large


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
    return vt[rank:].T


def independent_rows(matrix: Array, tolerance: float) -> Array:
    """Return orthonormal combinations of rows that are independent, or the identity if all rows are.

    Parameters
    ----------
    matrix : ndarray, shape (m, n)
    tolerance : float
        Of singular values, as in `null_space`.

    Returns
    -------
    combinations : ndarray, shape (rank, m)
    """
    count = len(matrix)
    if not matrix.size:
        return np.zeros((0, count))
    left, values, _ = np.linalg.svd(matrix, full_matrices=False)
    rank = int(np.sum(values > tolerance * max(values[0], 1.0)))
    return np.eye(count) if rank == count else np.ascontiguousarray(left[:, :rank].T)


def spanning_rows(matrix: Array, tolerance: float) -> list[int]:
    """Return which rows span all of them, each the one farthest from what those before it span.

    Of rows that are as long but for a hundredth the first is taken: round-off decides nothing.

    Parameters
    ----------
    matrix : ndarray, shape (m, n)
    tolerance : float
        A row that is no longer than this multiple of the longest one, or of 1 if that is larger, is left out.
    """
    left = np.array(matrix, dtype=np.float64)
    found: list[int] = []
    least = tolerance * max(float(np.linalg.norm(left, axis=1).max(initial=0.0)), 1.0)
    for _ in range(min(left.shape)):
        lengths = np.linalg.norm(left, axis=1)
        longest = lengths.max()
        if longest <= least:
            break
        place = int(np.argmax(lengths >= _TIE * longest))
        found.append(place)
        unit = left[place] / lengths[place]
        left -= np.outer(left @ unit, unit)
    return sorted(found)


def largest_entry(row: Array) -> int:
    """Return where the largest entry of a row is, by size; of those that are equal but for 1 % the first."""
    sizes = np.abs(row)
    return int(np.argmax(sizes >= _TIE * sizes.max()))


def align(basis: Array) -> Array:
    """Return the orthonormal basis of the same space of which round-off decides nothing.

    An SVD leaves open how singular vectors of equal values are turned. Of this basis, entries that say all
    others make a lower triangle with a positive diagonal.

    Parameters
    ----------
    basis : ndarray, shape (n, k)
        Orthonormal columns.
    """
    if not basis.size:
        return basis
    entries = spanning_rows(basis, 0.0)
    found: Array = basis @ np.linalg.qr(basis[entries].T)[0]
    return found * np.sign(np.diag(found[entries]))


def norm(vector: Array) -> float:
    """Return the Euclidean norm of a vector, shape (n,), also where squares of entries have no number.

    An iterate that runs away is no error of arithmetic: its norm is a large number, or infinite.
    """
    with np.errstate(over="ignore"):
        size = math.sqrt(vector.dot(vector))
    has_no_squares = math.isinf(size) or (size < _SMALL and vector.any())
    return math.hypot(*vector.tolist()) if has_no_squares else size
