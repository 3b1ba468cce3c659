"""A frame that follows a spline: at every node on it, or near its nearest point, which does not go back."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from tests.checker.further import Bound
from tests.checker.system import Array, System
from tests.checker.task import Followed, Task

if TYPE_CHECKING:
    from tests.checker.conditions import Layout, Motion

__all__ = ["follow_bounds", "follow_equations", "follow_missed", "spline"]

_SAMPLES = 4000  # among which the nearest point is looked for
_NEWTON, _SETTLED = 20, 1e-14
_LEAST, _MOST = -1e-2, 8.0  # paces, in units of the mean one
_PART = 1.0 / 3.0  # of the path, at most, in a step


def spline(path: Followed) -> CubicSpline:
    """By the distances of its points, from 0 to 1."""
    lengths = np.linalg.norm(np.diff(path.points, axis=0), axis=1)
    knots = np.append(0.0, np.cumsum(lengths)) / lengths.sum()
    return CubicSpline(knots, path.points)


class _Along:
    """Places on the path that are nearest to the nodes of a motion."""

    def __init__(self, system: System, path: Followed, qs: Array) -> None:
        self.system, self.path, self.qs = system, path, qs
        self.frame = system.model.getFrameId(path.frame)
        self.curve = spline(path)
        self.ps = []
        for q in qs:
            system.place(q)
            self.ps.append(np.array(system.data.oMf[self.frame].translation))
        samples = np.linspace(0.0, 1.0, _SAMPLES + 1)
        gaps = ((np.array(self.ps)[:, None] - self.curve(samples)[None]) ** 2).sum(axis=2)
        self.s = self._nearest(samples, gaps)

    def _nearest(self, samples: Array, gaps: Array) -> Array:
        """From each node on, of the samples that are not much before the last; then by Newton's method."""
        found, last = [], 0.0
        for p, gap in zip(self.ps, gaps, strict=True):
            ahead = (samples >= last - 0.02) & (samples <= last + _PART)
            s = float(samples[np.argmin(np.where(ahead, gap, np.inf))])
            for _ in range(_NEWTON):
                away, first, second = self.curve(s) - p, self.curve(s, 1), self.curve(s, 2)
                by = float(away @ first) / float(first @ first + away @ second)
                s -= by
                if abs(by) < _SETTLED:
                    break
            found.append(s)
            last = s
        return np.array(found)

    def moved(self, n: int) -> Array:
        """Derivative of the frame's origin in q, shape (3, nv)."""
        self.system.place(self.qs[n])
        return np.asarray(self.system.frame_jacobian(self.frame, pin.LOCAL_WORLD_ALIGNED)[:3])

    def away(self, n: int) -> Array:
        return np.asarray(self.ps[n] - self.curve(self.s[n]))

    def slope(self, n: int) -> Array:
        """Derivative of s in q."""
        away, first, second = self.away(n), self.curve(self.s[n], 1), self.curve(self.s[n], 2)
        return np.asarray(first @ self.moved(n) / float(first @ first - away @ second))

    def across(self, n: int) -> Array:
        """Two directions across the path, shape (2, 3)."""
        return np.asarray(np.linalg.svd(self.curve(self.s[n], 1)[None])[2][1:])


def follow_equations(system: System, task: Task, motion: Motion) -> Iterator[tuple[int, Array]]:
    """Node, and rows on its state: on the path without a tolerance, and at its end."""
    for path in task.followed:
        along = _Along(system, path, motion.qs)
        for n in range(1, task.num_steps + 1):
            blocks = [along.slope(n)[None]] if n == task.num_steps else []
            if not path.tolerance:
                blocks.append(along.across(n) @ along.moved(n))
            if blocks:
                rows = np.vstack(blocks)
                yield n, np.hstack([rows, np.zeros_like(rows)])


def follow_missed(system: System, task: Task, motion: Motion) -> float:
    """Largest distance from a path without a tolerance, and from where it ends along it [m]."""
    worst = 0.0
    for path in task.followed:
        along = _Along(system, path, motion.qs)
        length = np.linalg.norm(np.diff(path.points, axis=0), axis=1).sum()
        for n in range(1, task.num_steps + 1) if not path.tolerance else ():
            worst = max(worst, float(np.linalg.norm(along.away(n))))
        worst = max(worst, float(abs(along.s[-1] - 1.0) * length))
    return worst


def follow_bounds(system: System, task: Task, motion: Motion, layout: Layout) -> Iterator[Bound]:
    """Tubes about paths, and paces along them."""
    nv, N = system.nv, task.num_steps
    at = [np.zeros(0, dtype=int)] + [layout.x(n).start + np.arange(nv) for n in range(1, N + 1)]
    most = float(np.clip(_PART * N, 3.0, _MOST)) / N
    for path in task.followed:
        along = _Along(system, path, motion.qs)
        slopes = [along.slope(n) for n in range(N + 1)]
        for n in range(1, N + 1):
            if path.tolerance:
                away = along.away(n)
                size = float(np.linalg.norm(away))
                slope = away @ along.moved(n) / max(size, 1e-300)
                yield Bound(f"tube[{n}]", size - path.tolerance, path.tolerance, at[n], slope, np.nan)
            if n in (1, N):  # before the first node and behind the last nothing is free
                columns, slope = (at[1], slopes[1]) if n == 1 else (at[N - 1], -slopes[N - 1])
            else:
                columns = np.concatenate([at[n - 1], at[n]])
                slope = np.concatenate([-slopes[n - 1], slopes[n]])
            gained = along.s[n] - along.s[n - 1]
            yield Bound(f"pace[{n}]", gained - most, most, columns, slope, np.nan)
            yield Bound(f"pace[{n}]", _LEAST / N - gained, most, columns, -slope, np.nan)
