"""Functions of a programme at many points at once, by the kernel."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbocp._arrays import Array, IntArray
from mbocp.exceptions import SolverError
from mbocp.programme.compilation import CompiledFunctions


class Nonzeros(NamedTuple):
    """Numbers of one output of a function at some points.

    Attributes
    ----------
    rows, columns : ndarray of int, shape (nnz,)
    values : ndarray, shape (count, nnz)
    """

    rows: IntArray
    columns: IntArray
    values: Array

    def dense(self, size: int) -> Array:
        """Columns, shape (count, size)."""
        found = np.zeros((len(self.values), size))
        found[:, self.rows] = self.values
        return found

    def matrix(self, shape: tuple[int, int]) -> Array:
        """The matrix at the first point."""
        found = np.zeros(shape)
        found[self.rows, self.columns] = self.values[0]
        return found


def call(
    functions: CompiledFunctions, name: str, count: int, inputs: Sequence[Array]
) -> tuple[Nonzeros, ...]:
    """Outputs of a function at `count` points; inputs are of each point, or of all.

    Raises
    ------
    SolverError
        If a function fails.
    """
    sizes, patterns = _shapes(functions.function(name))
    given = [
        value.ravel() if value.size == count * size else np.tile(value.ravel(), count)
        for value, size in zip(inputs, sizes, strict=True)
    ]
    try:
        found = functions.stage_function(name).evaluate(given, count, True)
    except RuntimeError as error:  # the kernel: a function has failed
        raise SolverError(f"{name}: functions of the problem are not finite there") from error
    return tuple(
        Nonzeros(*pattern, values.reshape(count, -1)) for pattern, values in zip(patterns, found, strict=True)
    )


@lru_cache(maxsize=64)
def _shapes(function: ca.Function) -> tuple[list[int], list[tuple[IntArray, IntArray]]]:
    """Sizes of the inputs of a function, and rows and columns of the numbers of its outputs."""
    triplets = [function.sparsity_out(k).get_triplet() for k in range(function.n_out())]
    patterns = [
        (np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp)) for rows, columns in triplets
    ]
    return [function.size1_in(k) for k in range(function.n_in())], patterns
