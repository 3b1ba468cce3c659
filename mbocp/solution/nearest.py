r"""The motion nearest to another one that keeps the limits of its joints from the state in which it begins.

A moving mean of a motion that begins moving does not begin in its state. What is sent in its place has jerks
j_n that are constant in pieces of a time h. Of all that keep the limits each joint takes the nearest one, by
a convex quadratic programme: with q* the motion in as much more time as it needs, slowed between its ends,

.. math::
    \min \sum_n (q_n - q^*_n)^2 + (10\, h^3 j_n)^2, \qquad \underline q \le q_n \le \overline q, \quad
    |v_n| \le \overline v, \quad |a_n| \le \overline a, \quad |j_n| \le \overline j.

Accelerations are linear in pieces, and keep limits between nodes, too. Speeds may leave theirs where they
turn within a piece: that place is one more row then, and the programme is solved again. So are speeds that
fall towards the limit of a position, v <= sqrt(2 a d) - r at d before it: what keeps that is convex, and the
row is a tangent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from mbocp._arrays import Array, BoolArray, IntArray
from mbocp._dataclass import dataclass
from mbocp.solution.curves import Curves
from mbocp.solution.problem_facts import BrakingPlace
from mbocp.solution.quadratic import minimise

KINDS = ("position", "speed", "acceleration", "jerk")
_PARTS = 4  # pieces to a step of the motion
_LEAST_PIECE = 1e-3  # [s]: jerks have round-off by the cube of it
_LEAST_PIECES, _MANY_PIECES = 8, 400
_SMOOTH = 10.0
_ROUNDS = 8  # of rows for what is left within pieces
_PLACES = np.linspace(0.0, 1.0, 9)[1:]  # in a piece, at which speeds are compared with positions
_LEFT = 1e-8  # relative: a limit that is left by less is kept
_TRIES = 6  # of a duration: to 0.2 % of it, where a tenth more is allowed
_LEAST_ROOM = 1e-9  # [rad, m] before the limit of a position
_LEAST_SPEED = 1e-6  # [rad/s, m/s], to count others in
_NO_LIMIT = np.array([-np.inf, np.inf])


@dataclass(frozen=True, eq=False)
class Ends:
    """What a motion begins and ends with, beside its positions and velocities.

    Attributes
    ----------
    accelerations : ndarray, shape (joints,)
        At the start; NaN where it may be any.
    is_asked : ndarray of bool, shape (joints,)
        Which positions at the end are asked for.
    rests : ndarray of bool, shape (joints,)
        Which joints end with no acceleration.
    """

    accelerations: Array
    is_asked: BoolArray
    rests: BoolArray


@dataclass(frozen=True, eq=False)
class Nearest:
    """Of a motion: the nearest one that keeps limits.

    Attributes
    ----------
    motion : Curves
    bounds : mapping of str to ndarray, shape (2, joints)
        Lower and upper limits by `KINDS`, infinite where there are none.
    braking : tuple of tuple of BrakingPlace
        Of each joint: how its speed falls towards limits of its position.
    ends : Ends
    """

    motion: Curves
    bounds: Mapping[str, Array]
    braking: tuple[tuple[BrakingPlace, ...], ...]
    ends: Ends

    def least_factor(self, least: float, most: float) -> float | None:
        """The least factor of the duration at which there is one; None if there is none up to the most."""
        for k in range(self.motion.q.shape[1]):
            if self._joint(k, least).solve() is not None:
                continue
            if self._joint(k, most).solve() is None:
                return None
            low, least = least, most
            for _ in range(_TRIES):
                middle = (low + least) / 2.0
                low, least = (middle, least) if self._joint(k, middle).solve() is None else (low, middle)
        return least

    def slow(self, factor: float) -> Curves | None:
        """The nearest motion in a factor of the duration, if there is one."""
        joints = [self._joint(k, factor) for k in range(self.motion.q.shape[1])]
        found = [one for joint in joints if (one := joint.solve()) is not None]
        if len(found) < len(joints):
            return None
        q, v, a, _ = (np.column_stack(one) for one in zip(*found, strict=True))
        return Curves(joints[0].times, q, v, a)

    def _joint(self, k: int, factor: float) -> _Joint:
        motion, ends = self.motion, self.ends
        duration, steps = factor * float(motion.nodes[-1]), len(motion.nodes) - 1
        pieces = min(_PARTS * steps, max(steps, _MANY_PIECES), int(duration / _LEAST_PIECE))
        pieces = max(pieces, _LEAST_PIECES)
        shares = np.linspace(0.0, 1.0, pieces + 1)
        late = (duration - motion.nodes[-1]) * (3.0 - 2.0 * shares) * shares**2
        wanted = motion.at(duration * shares - late)[0][:, k]
        sides = np.array([self.bounds[kind][:, k] if kind in self.bounds else _NO_LIMIT for kind in KINDS])
        begin = np.array([motion.q[0, k], motion.v[0, k], ends.accelerations[k]])
        last = motion.q[-1, k] if ends.is_asked[k] else np.nan, 0.0 if ends.rests[k] else np.nan
        end = np.array([last[0], motion.v[-1, k], last[1]])
        return _Joint(duration * shares, wanted, _widened(sides, begin), self.braking[k], begin, end)


def _widened(sides: Array, begin: Array) -> Array:
    """Limits of a joint, wider where it has left them already as it begins, or can no longer keep them."""
    q, v, a = np.nan_to_num(begin)
    turned = v + a * abs(a) / (2.0 * np.abs(sides[3]).min())  # its speed when the acceleration is gone
    forced = np.array([[q, q], [v, turned], [a, a]])
    low, high = np.minimum(sides[:3, 0], forced.min(axis=1)), np.maximum(sides[:3, 1], forced.max(axis=1))
    return np.vstack([np.column_stack([low, high]), sides[3]])


@dataclass(frozen=True, eq=False)
class _Joint:
    """A joint: n times, wanted positions, limits by `KINDS`, shape (4, 2); braking; ends, NaN where free.

    Unknown are positions, velocities and accelerations at the times, and the jerks between these, by their
    units.
    """

    times: Array
    wanted: Array
    sides: Array
    braking: tuple[BrakingPlace, ...]
    begin: Array
    end: Array

    def solve(self) -> Array | None:
        """Positions and three derivatives at the times, shape (4, n), the last jerk twice; None if none."""
        import scipy.sparse as sparse  # slow to import, and no solve wants it

        n, h = len(self.times), self._piece
        weights, linear = np.zeros(4 * n - 1), np.zeros(4 * n - 1)
        weights[:n], weights[3 * n :] = self._units[0] ** 2, (_SMOOTH * h**3 * self._units[3]) ** 2
        linear[:n] = -self._units[0] * self.wanted
        equations, (rows, most) = self._equations(), self._limits()
        for _ in range(_ROUNDS):
            x = minimise(weights, linear, equations, (rows, most))
            if x is None:
                return None
            found = self._follow(x)
            more, sides = self._left(found)
            if not len(sides):
                return found
            rows, most = sparse.vstack([rows, more], format="csr"), np.append(most, sides)
        return found

    @property
    def _piece(self) -> float:
        return float(self.times[1])

    @cached_property
    def _units(self) -> Array:
        """Of the unknowns: their limits, or about what they are where these are free, shape (4,)."""
        duration = float(self.times[-1])
        speed = max(float(np.abs(np.diff(self.wanted)).max()) / self._piece, _LEAST_SPEED)
        usual = np.array([speed * duration, speed, speed / duration, speed / duration**2])
        sizes = np.abs(self.sides).max(axis=1)
        return np.where(np.isfinite(sizes) & (sizes > 0.0), sizes, usual)

    def _places(self, order: int) -> IntArray:
        """Of the unknowns of an order."""
        n = len(self.times)
        return np.arange(order * n, order * n + n - (order == 3))

    def _taylor(self, order: int, pieces: IntArray, spans: Array) -> Any:
        """Rows of a derivative some time [s] after the begin of pieces, by its unit."""
        import scipy.sparse as sparse

        count, entries, places = len(pieces), [], []
        for k in range(order, 4):
            factor = spans ** (k - order) / math.factorial(k - order) * self._units[k] / self._units[order]
            entries.append(factor)
            places.append(self._places(k)[pieces])
        at = np.tile(np.arange(count), 4 - order), np.concatenate(places)
        return sparse.csr_matrix((np.concatenate(entries), at), shape=(count, 4 * len(self.times) - 1))

    def _equations(self) -> tuple[Any, Array]:
        """What leads from time to time, and what the ends are."""
        import scipy.sparse as sparse

        pieces, spans = np.arange(len(self.times) - 1), np.full(len(self.times) - 1, self._piece)
        rows = [self._taylor(k, pieces, spans) - self._picked(self._places(k)[1:]) for k in range(3)]
        right = [np.zeros(3 * len(pieces))]
        for state, n in ((self.begin, 0), (self.end, -1)):
            given = np.isfinite(state)
            rows.append(self._picked(np.array([self._places(k)[n] for k in range(3)])[given]))
            right.append((state / self._units[:3])[given])
        return sparse.vstack(rows, format="csr"), np.concatenate(right)

    def _limits(self) -> tuple[Any, Array]:
        """Limits at all times but the ends that are given."""
        places, signs, most = [], [], []
        for k, sides in enumerate(self.sides):
            own = self._places(k)
            if k < 3:
                own = own[int(np.isfinite(self.begin[k])) : len(own) - int(np.isfinite(self.end[k]))]
            for sign, side in zip((-1.0, 1.0), sides, strict=True):
                if np.isfinite(side):
                    places.append(own)
                    signs.append(np.full(len(own), sign))
                    most.append(np.full(len(own), sign * side / self._units[k]))
        return self._picked(np.concatenate(places), np.concatenate(signs)), np.concatenate(most)

    def _picked(self, places: IntArray, signs: Array | None = None) -> Any:
        """Rows of one unknown each."""
        import scipy.sparse as sparse

        entries = np.ones(len(places)) if signs is None else signs
        shape = len(places), 4 * len(self.times) - 1
        return sparse.csr_matrix((entries, places, np.arange(len(places) + 1)), shape)

    def _follow(self, x: Array) -> Array:
        """What the jerks lead to, so that all is one motion to round-off."""
        h, j = self._piece, x[self._places(3)] * self._units[3]
        found = np.zeros((4, len(self.times)))
        found[:3, 0] = [x[self._places(k)[0]] * self._units[k] for k in range(3)]
        found[:3, 0] = np.where(np.isfinite(self.begin), self.begin, found[:3, 0])
        found[3] = np.append(j, j[-1])
        for k in (2, 1, 0):
            moves = sum(found[k + i, :-1] * h**i / math.factorial(i) for i in range(1, 4 - k))
            found[k, 1:] = found[k, 0] + np.cumsum(moves)
        return found

    def _left(self, found: Array) -> tuple[Any, Array]:
        """Rows, and their bounds, of what a motion leaves within pieces."""
        import scipy.sparse as sparse

        left = [self._turns(found, sign) for sign in (-1.0, 1.0)]
        left += [self._too_fast(found, place, sign) for place in self.braking for sign in (-1.0, 1.0)]
        return sparse.vstack([rows for rows, _ in left], format="csr"), np.concatenate([m for _, m in left])

    def _turns(self, found: Array, sign: float) -> tuple[Any, Array]:
        """Speeds beyond a limit where they turn."""
        a, j = found[2, :-1], found[3, :-1]
        turns = np.flatnonzero(a * found[2, 1:] < 0.0)
        spans, side = -a[turns] / j[turns], self.sides[1, int(sign > 0.0)]
        is_left = sign * (found[1, turns] + a[turns] * spans / 2.0 - side) > _LEFT * self._units[1]
        rows = sign * self._taylor(1, turns[is_left], spans[is_left])
        return rows, np.full(int(is_left.sum()), sign * side / self._units[1])

    def _too_fast(self, found: Array, place: BrakingPlace, sign: float) -> tuple[Any, Array]:
        """Tangents where it is too fast before a limit of its position, at the worst time of pieces."""
        spans, limit = self._piece * _PLACES[:, None], place.upper if sign > 0.0 else place.lower
        x, v0, a, j = found[:, :-1]
        q, v = x + spans * (v0 + spans * (a / 2.0 + spans * j / 6.0)), v0 + spans * (a + spans * j / 2.0)
        braked = np.sqrt(2.0 * place.deceleration * np.maximum(sign * (limit - q), _LEAST_ROOM))
        over = sign * v - (braked - place.reserve)
        worst = over.argmax(axis=0)
        pieces = np.flatnonzero(over.max(axis=0) > _LEFT * self._units[1])
        at, units = (worst[pieces], pieces), self._units
        slopes = sign * place.deceleration / braked[at]
        of_speed, of_position = (self._taylor(k, pieces, spans[worst[pieces], 0]) for k in (1, 0))
        rows = sign * of_speed + of_position.multiply((slopes * units[0] / units[1])[:, None])
        return rows, (braked[at] - place.reserve + slopes * q[at]) / units[1]
