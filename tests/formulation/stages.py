"""Points at which stage functions of free step lengths are looked at, and their derivatives there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest

from mbocp.formulation.base import Formulation

__all__ = ["Point", "check_derivatives", "near"]


class Point(NamedTuple):
    """Arguments of a stage function."""

    x0: Any
    x1: Any
    y: Any
    u: Any


def near(formulation: Formulation, seed: int = 5) -> tuple[Point, np.ndarray]:
    """Some point not far from the start, where rotations are rotations nearly, and multipliers."""
    rng, kind = np.random.default_rng(seed), formulation.programme.kind
    x0 = formulation.programme.x_start + 0.05 * rng.standard_normal(kind.nx)
    x1 = x0 + 0.1 * rng.standard_normal(kind.nx)
    point = Point(x0, x1, rng.standard_normal(kind.ny), 0.3 * rng.standard_normal(kind.nu))
    return point, rng.standard_normal(kind.ndx + kind.ny)


def check_derivatives(formulation: Formulation, stage: int, alone: Sequence[int]) -> None:
    """Compare with differences of fourth order along random lines, and along single unknowns.

    `alone` are rows of the state before the step; the last control, a change of the length, joins them.
    """
    programme, at = formulation.programme, formulation.layout
    point, m = near(formulation)
    rho = programme.rho.reshape(programme.num_steps, -1)[stage]
    values, complete = (programme.functions.function(name) for name in ("values", "complete"))
    _, _, dc, dl, upper = (np.array(o.full()) for o in complete(*point, m, programme.theta, rho))
    dl, hessian = dl.ravel(), np.triu(upper) + np.triu(upper, 1).T
    sizes = [at.ndx, point.y.size, at.ndx, point.u.size]
    rng, every = np.random.default_rng(1), np.eye(sum(sizes))
    directions = [rng.standard_normal(sum(sizes)) for _ in range(3)]
    directions += [*(every[at.ndx + point.y.size + row] for row in alone), every[-1]]
    for direction in directions:
        d1, dy, d0, du = np.split(direction, np.cumsum(sizes)[:-1])

        def lagrangian(t: float, d0=d0, d1=d1, dy=dy, du=du) -> np.ndarray:
            moved = (point.x0 + t * d0, point.x1 + t * d1, point.y + t * dy, point.u + t * du)
            c, cost = values(*moved, programme.theta, rho)
            return np.append(np.asarray(c).ravel(), float(cost) + m @ np.asarray(c).ravel())

        h = 1e-3
        a, b, c, d = (lagrangian(t) for t in (h, -h, 2 * h, -2 * h))
        slope = (8 * (a - b) - (c - d)) / (12 * h)
        bend = ((16 * (a + b) - (c + d) - 30 * lagrangian(0.0)) / (12 * h * h))[-1]
        wanted = np.append(dc @ direction, (dl + m @ dc) @ direction)
        scale = 1.0 + np.abs(wanted).max() + np.abs(a).max()
        assert np.allclose(slope, wanted, atol=1e-8 * scale)
        curvature = direction @ hessian @ direction
        assert bend == pytest.approx(curvature, abs=1e-6 * (scale + abs(curvature)))
