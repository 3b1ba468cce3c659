"""Problems in which rows keep apart what comes near each other, and no more.

A robot of sixty spheres among twenty obstacles has a thousand pairs, of which a motion comes near a few
dozen. The others have no rows as long as no motion comes near them, too.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array
from mbocp.problem.obstacles.clearance import Clearance
from mbocp.robot.nodes import between

if TYPE_CHECKING:
    from mbocp.problem.problem import Problem

MANY = 48  # pairs, from which on they are chosen
_NEAR = 0.05  # [m]
_MOST = 64  # chosen pairs at first
_BETWEEN = 4  # configurations of a step
_MISSED = 0.01  # [m] from what is missing, what is taken, too


def near_pairs(clearance: Clearance, ts: Array, qs: Array) -> tuple[int, ...]:
    """Pairs that come near along some configurations at their times, the nearest first."""
    near = float(clearance.margins.max(initial=0.0)) + _NEAR
    least = (clearance.pair_values(qs, near, ts) - clearance.margins).min(axis=0)
    order = np.argsort(least, kind="stable")
    count = int(np.clip(np.count_nonzero(least < _NEAR), 1, _MOST))
    return tuple(order[:count].tolist())


def missing_pairs(problem: Problem, ts: Array, qs: Array) -> tuple[int, ...]:
    """Pairs without rows that touch along the nodes of a motion, and others near it; none if none does."""
    clearance, rows = problem.clearance, rows_of(problem)
    if clearance is None or rows is None or rows.chosen is None or not np.isfinite(qs).all():
        return ()
    first = np.repeat(np.arange(len(qs) - 1), _BETWEEN)
    shares = np.tile(np.arange(_BETWEEN) / _BETWEEN, len(qs) - 1)
    sampled = np.vstack([between(problem.robot, qs[first], qs[first + 1], shares), qs[-1:]])
    times = np.append((1.0 - shares) * ts[first] + shares * ts[first + 1], ts[-1])
    near = float(clearance.margins.max(initial=0.0)) + _NEAR
    least = (clearance.pair_values(sampled, near, times) - clearance.margins).min(axis=0)
    least[list(rows.chosen)] = np.inf
    if least.min() >= 0.0:
        return ()
    return tuple(np.flatnonzero(least < _MISSED).tolist())


def with_pairs(problem: Problem, chosen: Collection[int]) -> Problem:
    """The problem with rows for some of its pairs; it is not checked again."""
    rows = rows_of(problem)
    if rows is None:
        return problem
    path = tuple(rows.of_pairs(tuple(chosen), rows.reserve) if c is rows else c for c in problem.path)
    return replace(problem, path=path)


def rows_of(problem: Problem) -> Clearance | None:
    """The clearance whose rows a problem has."""
    return next((c for c in problem.path if isinstance(c, Clearance)), None)
