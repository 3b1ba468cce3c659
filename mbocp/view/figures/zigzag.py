"""Curves that jump to one side and the other of a smooth mean, as undamped adjoints of index 3 do."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array

SHORT_NOTE = "mean of neighbours; faint: as computed"
_FEWEST = 8  # values of which one can say that they zigzag
_MOST_TIMES = 3
_ALTERNATES = 0.9  # part of the steps at which the sign changes; of noise it is two thirds
_VISIBLE = 0.02  # of the range of the mean: smaller jumps are drawn as they are


def without_zigzag(values: Array) -> Array:
    """Return the columns that zigzag as weighted means of neighbours, the others as they are.

    Means are taken until they zigzag no more, three times at most: each takes away what alternates with an
    amplitude linear in time. The two values at each end, where start and goal have equations of their own,
    follow the line through the next two means.

    Parameters
    ----------
    values : ndarray, shape (m, k)

    Returns
    -------
    ndarray, shape (m, k)
        `values` itself where no column zigzags.
    """
    if len(values) < _FEWEST or not np.isfinite(values).all():
        return values
    means = values
    for _ in range(_MOST_TIMES):
        smoother = _means(means)
        if smoother is means:
            break
        means = smoother
    return means


def _means(values: Array) -> Array:
    jumps = (values[:-2] - 2 * values[1:-1] + values[2:]) / 4
    inner = (values[1:-1] + jumps)[1:-1]
    lead, tail = inner[0] - inner[1], inner[-1] - inner[-2]
    means = np.vstack([inner[0] + 2 * lead, inner[0] + lead, inner, inner[-1] + tail, inner[-1] + 2 * tail])
    alternates = np.mean(jumps[:-1] * jumps[1:] < 0, axis=0) > _ALTERNATES
    visible = np.median(np.abs(jumps), axis=0) > _VISIBLE * np.ptp(means, axis=0)
    found = alternates & visible
    return np.where(found, means, values) if found.any() else values
