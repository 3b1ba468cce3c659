"""Derivatives by central differences of fourth order."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.checker.system import Array

__all__ = ["derivative"]

_WEIGHTS = ((1, 2 / 3), (2, -1 / 12))
_STEP = 1e-3  # truncation h^4 f''''' / 30 = 3e-14 f''''', round-off 1e-16 f / h = 1e-13 f


def derivative(function: Callable[[Array], Array], size: int, scales: Array | None = None) -> Array:
    """Jacobian at zero, shape (rows, size); the steps are `scales` times a fixed small number."""
    columns = []
    for i in range(size):
        h = _STEP * (1.0 if scales is None else scales[i])
        column: Array | float = 0.0
        for k, weight in _WEIGHTS:
            dx = np.zeros(size)
            dx[i] = k * h
            column = column + weight * (function(dx) - function(-dx))
        columns.append(np.asarray(column) / h)
    return np.array(columns).T
