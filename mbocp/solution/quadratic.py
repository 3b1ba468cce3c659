r"""Convex quadratic programmes of chains x_0, x_1 ... by Mehrotra's predictor and corrector, side by side.

.. math::
    \min \sum_n x_n' \operatorname{diag}(w_n) x_n / 2 + g_n' x_n, \qquad
    (x_{n+1})_{1..3} = A x_n, \quad \underline x_n \le x_n \le \overline x_n, \quad E x \le e.

Each row of E has entries of one x_n alone. So the Hessian has blocks, and what is left for the multipliers of
chains when all x_n are eliminated is banded: all chains are factorised at once.

References
----------
Mehrotra, "On the implementation of a primal-dual interior point method", 1992.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from mbocp._arrays import Array, BoolArray, IntArray, dataclass

_MOST_ITERATIONS = 40  # three times as many as programmes take that have a solution
_EXACT = 1e-11  # of rows, whose sizes are about one
_COMPLEMENTARY = 1e-10  # of slacks and multipliers
_INSIDE = 0.995  # of the way to the next limit
_FIRST = 0.1  # slack at the start
_GROWN = 1e18  # multipliers, of a linear part of about one, where there is no solution
_FREE = 1e-8  # weight of what nothing weighs, in steps alone
_GIVEN = 1e20  # weight of what is given, in steps alone
_BAND = 6  # the diagonal, and what is below it


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of E, with e: what an x_n does by `entries` is at most `most`.

    Attributes
    ----------
    at : ndarray of int, shape (rows,)
        Of the x_n of all chains, one after the other.
    entries : ndarray, shape (rows, 4)
    most : ndarray, shape (rows,)
    """

    at: IntArray
    entries: Array
    most: Array

    @classmethod
    def of(cls, parts: list[Rows]) -> Rows:
        """Those of all parts."""
        names = ("at", "entries", "most")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    @cached_property
    def groups(self) -> list[IntArray]:
        """Numbers of rows, no two of one x_n together."""
        order = np.argsort(self.at, kind="stable")
        before = np.arange(len(order)) - np.searchsorted(self.at[order], self.at[order])
        return [order[before == k] for k in range(before.max(initial=-1) + 1)]


@dataclass(frozen=True, eq=False)
class Chains:
    """Programmes of c chains of n.

    Attributes
    ----------
    leads : ndarray, shape (c, 3, 4)
        A.
    weights, linear : ndarray, shape (c, n, 4)
        w, 0 or above, and g; sizes of all x are about one.
    sides : ndarray, shape (2, c, n, 4)
        Limits of x, finite, and on both sides of what is given.
    given : ndarray, shape (c, n, 4)
        Entries of x that are given; NaN where they are not.
    rows : Rows
    """

    leads: Array
    weights: Array
    linear: Array
    sides: Array
    given: Array
    rows: Rows

    def minimise(self) -> tuple[Array, BoolArray]:
        """Find the minimum of each.

        Returns
        -------
        x : ndarray, shape (c, n, 4)
        is_found : ndarray of bool, shape (c,)
            False where there is no solution, or it is not found. Where one has none others only keep limits.
        """
        shape, owner = self.weights.shape, self._owner
        count, is_given, size = shape[0], ~np.isnan(self.given), np.bincount(owner)
        is_found, is_lost = np.zeros((2, count), dtype=bool)
        x, y = np.where(is_given, self.given, 0.0), np.zeros((count, shape[1] - 1, 3))
        s = np.ones(len(owner))
        z = np.maximum(np.abs(self.linear).max(axis=(1, 2)), _FIRST)[owner]
        pulls = self.weights * x + self.linear - self._transpose(self._gaps(x))
        x = x + _Factors(self, s, is_lost).solve(pulls, self._measure_breaks(x))[0]
        s = np.maximum(self._gaps(x), _FIRST)
        for _ in range(_MOST_ITERATIONS):
            gaps, broken = self._gaps(x), self._measure_breaks(x)
            forces = self._transpose(z) + self._pulls(y)
            together = np.bincount(owner, s * z)
            exact = np.maximum(self._largest(np.abs(s - gaps)), np.abs(broken).max(axis=(1, 2)))
            is_good = (together < _COMPLEMENTARY * size) | is_lost.any()
            is_found |= ~is_lost & (exact < _EXACT) & is_good
            # Of all x within limits forces . x would be above 0.
            reach = np.where(is_given, 0.0, np.maximum(*gaps[: 2 * x.size].reshape(2, *shape)))
            proof = np.bincount(owner, z * gaps) - (y * broken).sum(axis=(1, 2))
            proof += (reach * np.abs(forces)).sum(axis=(1, 2))
            is_lost |= ~is_found & ~((self._largest(z) < _GROWN) & (proof >= 0.0))
            moves = ~(is_found | is_lost)
            if not moves.any():
                break
            factors = _Factors(self, z / s, is_lost)
            left = (self.weights * x + self.linear + forces, s - gaps, broken)
            _, _, ds, dz = factors.step(s, z, left, s * z)
            primal, dual = self._lengths(s, ds), self._lengths(z, dz)
            share = np.bincount(owner, (s + primal[owner] * ds) * (z + dual[owner] * dz)) / together
            products = s * z + ds * dz - (share**3 * together / size)[owner]
            dx, dy, ds, dz = factors.step(s, z, left, products)
            primal, dual = (
                _INSIDE * moves * self._lengths(one, change) for one, change in ((s, ds), (z, dz))
            )
            x, s = x + primal[:, None, None] * dx, s + primal[owner] * ds
            y, z = y + dual[:, None, None] * dy, z + dual[owner] * dz
        return x, is_found

    @cached_property
    def _owner(self) -> IntArray:
        """Chains of all limits: lower ones, upper ones, rows."""
        count, length, width = self.weights.shape
        sides = np.repeat(np.arange(count), length * width)
        return np.concatenate([sides, sides, self.rows.at // length])

    @cached_property
    def _columns(self) -> Array:
        """A', in the order in which products are quick."""
        return np.ascontiguousarray(self.leads.transpose(0, 2, 1))

    @cached_property
    def _to_bands(self) -> tuple[Array, Array]:
        """What leads from inverse Hessians of x_n and x_{n+1} to columns of y_n in the bands of A H^-1 A'."""
        A, one = self.leads, np.broadcast_to(np.eye(3, 4), self.leads.shape)
        first, second, beside = (
            np.einsum("kri,kcj->krcij", rows, columns).reshape(len(A), 3, 3, 16)
            for rows, columns in ((A, A), (one, one), (-A, one))
        )
        own, later = np.zeros((2, len(A), 3, _BAND, 16))
        for column in range(3):
            own[:, column, : 3 - column] = first[:, column:, column]
            later[:, column, : 3 - column] = second[:, column:, column]
            later[:, column, 3 - column : 6 - column] = beside[:, :, column]
        return tuple(part.reshape(len(A), -1, 16).transpose(0, 2, 1) for part in (own, later))

    def _apply(self, x: Array) -> Array:
        """What limits look at."""
        of_rows = (self.rows.entries * x.reshape(-1, 4)[self.rows.at]).sum(axis=1)
        return np.concatenate([-x.ravel(), x.ravel(), of_rows])

    def _gaps(self, x: Array) -> Array:
        """How far it is to limits."""
        lower, upper = self.sides
        return np.concatenate([-lower.ravel(), upper.ravel(), self.rows.most]) - self._apply(x)

    def _transpose(self, z: Array) -> Array:
        """What multipliers of limits do to x."""
        lower, upper = z[: 2 * self.weights.size].reshape(2, *self.weights.shape)
        found = upper - lower
        np.add.at(found.reshape(-1, 4), self.rows.at, self.rows.entries * z[2 * found.size :, None])
        return found

    def _measure_breaks(self, x: Array) -> Array:
        """By what chains are apart."""
        return x[:, :-1] @ self._columns - x[:, 1:, :3]

    def _pulls(self, y: Array) -> Array:
        """What multipliers of chains do to x."""
        found = np.zeros_like(self.weights)
        found[:, :-1] = y @ self.leads
        found[:, 1:, :3] -= y
        return found

    def _largest(self, values: Array) -> Array:
        """Of each chain."""
        split = 2 * self.weights.size
        found = values[:split].reshape(2, len(self.weights), -1).max(axis=(0, 2))
        np.maximum.at(found, self._owner[split:], values[split:])
        return found

    def _lengths(self, values: Array, moves: Array) -> Array:
        """Largest part of moves of each chain, up to all, that leaves values above 0."""
        return 1.0 / np.maximum(1.0, self._largest(-moves / values))


class _Factors:
    """Of [[H + G' diag(w) G, A'], [A, 0]], with weights w of limits; chains that have none are lost."""

    def __init__(self, chains: Chains, w: Array, is_lost: BoolArray) -> None:
        from scipy.linalg.lapack import dpbtrf  # slow to import, and no solve wants it

        self._chains, weights, rows = chains, chains.weights, chains.rows
        count, length, _ = weights.shape
        of_lower, of_upper = w[: 2 * weights.size].reshape(2, *weights.shape)
        weights = np.where(np.isnan(chains.given), weights + of_lower + of_upper + _FREE, _GIVEN).reshape(
            -1, 4
        )
        inverse = np.zeros((len(weights), 4, 4))
        inverse[:, range(4), range(4)] = 1.0 / weights
        of_rows = w[2 * weights.size :]
        for some in rows.groups:
            at, entries = rows.at[some], rows.entries[some]
            pulled = np.einsum("nij,nj->ni", inverse[at], entries)
            sizes = 1.0 / of_rows[some] + (entries * pulled).sum(axis=1)
            inverse[at] -= pulled[:, :, None] * (pulled / sizes[:, None])[:, None, :]
        self._inverse = inverse
        flat, (own, later) = inverse.reshape(count, length, 16), chains._to_bands
        blocks = (flat[:, :-1] @ own + flat[:, 1:] @ later).reshape(count, length - 1, 3, _BAND)
        for column in range(3):
            blocks[:, -1, column, 3 - column :] = 0.0
        bands = blocks.reshape(-1, _BAND)
        size = len(bands) // count
        while True:
            self._factor, wrong = dpbtrf(bands.T, lower=1)
            if not wrong:
                return
            k = (wrong - 1) // size
            is_lost[k] = True
            bands[k * size : (k + 1) * size] = np.eye(1, _BAND)

    def solve(self, r: Array, broken: Array) -> tuple[Array, Array]:
        """Changes of x and y that take away pulls on x, and what chains are apart by."""
        from scipy.linalg.lapack import dpbtrs

        chains = self._chains
        right = broken - chains._measure_breaks(self._times(r))
        y = dpbtrs(self._factor, right.ravel(), lower=1)[0].reshape(right.shape)
        return -self._times(r + chains._pulls(y)), y

    def step(
        self, s: Array, z: Array, left: tuple[Array, Array, Array], products: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Changes of x, y, s and z that leave nothing, and take products of s and z away, to first order."""
        of_x, of_s, broken = left
        dx, dy = self.solve(of_x + self._chains._transpose((z * of_s - products) / s), broken)
        ds = -of_s - self._chains._apply(dx)
        return dx, dy, ds, -(products + z * ds) / s

    def _times(self, r: Array) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", self._inverse, r.reshape(-1, 4)).reshape(r.shape))
