"""Cubic splines through points: twice continuously differentiable curves, in numbers and in symbols.

A curve is its knots, shape (K + 1,), from 0 to 1 by chord length, and the coefficients of its K pieces,
shape (K, 4, d), highest power first, each piece in the distance from its first knot. Beyond its ends the
first and the last piece go on.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from mbocp._arrays import Array

_SAMPLES = 24  # of each piece, among which the nearest is looked for
_DRAWN = 8  # points of each piece in a picture
_MAX_SAMPLES = 4000
_SAME = 1e-9  # of the largest position or derivative
_NEWTON = 12  # steps from a sample to the nearest point; quadratic: three are typical
_CONVEX = 0.1  # of the slope's square: less is far from the curve, where Newton's steps are too long


class Curve(NamedTuple):
    """A curve through points, see the module."""

    knots: Array
    pieces: Array

    def at(self, s: Array, derivative: int = 0) -> Array:
        """Points, or derivatives, at parameters of shape (n,): shape (n, d)."""
        k = np.clip(np.searchsorted(self.knots, s, side="right") - 1, 0, len(self.pieces) - 1)
        away, c = (s - self.knots[k])[:, None], self.pieces[k]
        for _ in range(derivative):
            powers = np.arange(c.shape[1] - 1, 0, -1)
            c = c[:, :-1] * powers[None, :, None]
        found = np.zeros((len(s), self.pieces.shape[2]))
        for power in range(c.shape[1]):
            found = found * away + c[:, power]
        return found

    @property
    def points(self) -> Array:
        """The points that it goes through, shape (K + 1, d)."""
        return self.at(self.knots)

    @property
    def is_closed(self) -> bool:
        """Whether it ends as it begins, curvature included."""
        for derivative in range(3):
            there = self.at(self.knots, derivative)
            if np.abs(there[0] - there[-1]).max() > _SAME * np.abs(there).max():
                return False
        return True

    @property
    def polyline(self) -> Array:
        """Points that look like the curve, shape (k, 3)."""
        return self.at(np.linspace(0.0, 1.0, min(_DRAWN * len(self.pieces), _MAX_SAMPLES) + 1))[:, :3]

    def nearest(self, positions: Array) -> Array:
        """Parameters of the nearest points on its first three coordinates, shape (n,), that never fall.

        The sum of the squares of all distances is least among sequences of samples that do not fall; each is
        then moved to where its distance is least.

        Parameters
        ----------
        positions : ndarray, shape (n, 3)
            Of a frame along a motion [m].
        """
        count = min(_SAMPLES * len(self.pieces), _MAX_SAMPLES)
        samples = np.linspace(0.0, 1.0, count + 1)
        gaps = ((positions[:, None] - self.at(samples)[None, :, :3]) ** 2).sum(axis=2)
        chosen = _find_least_rising(gaps)
        s = samples[chosen]
        low, high = samples[np.maximum(chosen - 1, 0)], samples[np.minimum(chosen + 1, count)]
        for _ in range(_NEWTON):
            away = self.at(s)[:, :3] - positions
            first, second = self.at(s, 1)[:, :3], self.at(s, 2)[:, :3]
            slope = (away * first).sum(axis=1)
            square = (first**2).sum(axis=1)
            curvature = square + (away * second).sum(axis=1)
            curvature = np.where(curvature > _CONVEX * square, curvature, square)
            s = np.clip(s - slope / curvature, low, high)
        return np.maximum.accumulate(s)


def curve_through(points: Array, *, is_closed: bool) -> Curve:
    """Spline through points, shape (n, d); lengths are those of their first three coordinates.

    Parameters
    ----------
    points : ndarray, shape (n, d)
        At least two, of a closed curve at least three, the first of which it also ends at.
    """
    from scipy.interpolate import CubicSpline  # slow to import, and wanted only for curves

    through = np.vstack([points, points[:1]]) if is_closed else points
    lengths = np.linalg.norm(np.diff(through[:, :3], axis=0), axis=1)
    knots = np.append(0.0, np.cumsum(lengths) / lengths.sum())
    knots[-1] = 1.0
    spline = CubicSpline(knots, through, bc_type="periodic" if is_closed else "not-a-knot")
    c = np.asarray(spline.c)  # (powers, pieces, d); two or three points make less than a cubic
    pieces = np.zeros((len(knots) - 1, 4, points.shape[1]))
    pieces[:, 4 - len(c) :] = c.transpose(1, 0, 2)
    return Curve(knots, pieces)


def symbolic_curve(s: ca.SX, knots: ca.SX, pieces: ca.SX, size: int) -> tuple[ca.SX, ca.SX]:
    """Point and its derivative at a parameter, shapes (size,).

    Coefficients are chosen first, so that derivatives are those of one cubic.

    Parameters
    ----------
    knots : casadi.SX, shape (K + 1,)
    pieces : casadi.SX, shape (4 K size,)
        As `Curve.pieces` in the order of its memory.
    """
    K = knots.numel() - 1
    begun = [ca.SX(1), *(s >= knots[k] for k in range(1, K)), ca.SX(0)]
    start, c = ca.SX(0), ca.SX.zeros(4 * size)
    for k in range(K):
        here = begun[k] - begun[k + 1]
        start += here * knots[k]
        c += here * pieces[4 * size * k : 4 * size * (k + 1)]
    away, (a, b, g, d) = s - start, ca.vertsplit(c, size)
    return ((a * away + b) * away + g) * away + d, (3 * a * away + 2 * b) * away + g


def _find_least_rising(gaps: Array) -> np.ndarray[tuple[int, ...], np.dtype[np.intp]]:
    """Columns that never fall, one for each row, of least sum."""
    total = np.zeros(gaps.shape[1])
    before = np.empty(gaps.shape, dtype=np.intp)
    for n, row in enumerate(gaps):
        least = np.minimum.accumulate(total)
        places = np.where(total == least, np.arange(len(total)), 0)
        before[n] = np.maximum.accumulate(places)
        total = least + row
    found = np.empty(len(gaps), dtype=np.intp)
    column = int(np.argmin(total))
    for n in range(len(gaps) - 1, -1, -1):
        found[n] = column
        column = int(before[n, column])
    return found
