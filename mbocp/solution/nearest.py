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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from math import factorial

import numpy as np

from mbocp._arrays import Array, BoolArray, IntArray, dataclass
from mbocp.solution.curves import Curves
from mbocp.solution.problem_facts import BrakingPlace
from mbocp.solution.quadratic import Chains, Rows

KINDS = ("position", "speed", "acceleration", "jerk")
_PARTS = 4  # pieces to a step of the motion
_LEAST_PIECE = 1e-3  # [s]: jerks have round-off by the cube of it
_LEAST_PIECES, _MANY_PIECES = 8, 400
_SMOOTH = 10.0
_ROUNDS = 8  # of rows for what is left within pieces
_PLACES = np.linspace(0.0, 1.0, 9)[1:]  # in a piece, at which speeds are compared with positions
_LEFT = 1e-8  # relative: a limit that is left by less is kept
_LEAST_ROOM = 1e-9  # [rad, m] before the limit of a position
_LEAST_SPEED = 1e-6  # [rad/s, m/s], to count others in
_NO_LIMIT = np.array([-np.inf, np.inf])
_FAR = 1e3  # times its unit, which nothing comes to


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

    def fastest(self, factors: Sequence[float]) -> tuple[float, Curves] | None:
        """The first of some rising factors of the duration at which there is one, and this; if there is one.

        What a joint does at one factor it does at larger ones, so that those that need no more time wait.
        """
        if not len(factors):
            return None
        joints = slowest = list(range(self.motion.q.shape[1]))
        found: dict[int, dict[int, Array]] = {}

        def has(k: int) -> bool:
            nonlocal slowest
            found[k] = self._joints(slowest, factors[k]).solve()
            late = [joint for joint in slowest if joint not in found[k]]
            slowest = late or slowest
            return not late

        k = _first(has, len(factors))
        if k is None:
            return None
        if rest := [joint for joint in joints if joint not in found[k]]:
            found[k] |= self._joints(rest, factors[k]).solve()
        if len(found[k]) < len(joints):
            return self.fastest(factors[k + 1 :])
        q, v, a, _ = np.stack([found[k][joint] for joint in joints], axis=2)
        return factors[k], Curves(np.linspace(0.0, factors[k] * self.motion.nodes[-1], len(q)), q, v, a)

    def _joints(self, joints: list[int], factor: float) -> _Joints:
        motion, ends = self.motion, self.ends
        duration, steps = factor * float(motion.nodes[-1]), len(motion.nodes) - 1
        pieces = min(_PARTS * steps, max(steps, _MANY_PIECES), int(duration / _LEAST_PIECE))
        shares = np.linspace(0.0, 1.0, max(pieces, _LEAST_PIECES) + 1)
        late = (duration - motion.nodes[-1]) * (3.0 - 2.0 * shares) * shares**2
        wanted = motion.at(duration * shares - late)[0].T
        free = np.tile(_NO_LIMIT[:, None], len(wanted))
        sides = np.array([self.bounds.get(kind, free) for kind in KINDS])
        begin = np.array([motion.q[0], motion.v[0], ends.accelerations])
        asked = np.where(ends.is_asked, motion.q[-1], np.nan), np.where(ends.rests, 0.0, np.nan)
        end = np.array([asked[0], motion.v[-1], asked[1]])
        own = (wanted[joints], _widen(sides, begin)[..., joints], begin[:, joints], end[:, joints])
        return _Joints(tuple(joints), duration / (len(shares) - 1), *own, [self.braking[k] for k in joints])


def _first(has: Callable[[int], bool], count: int) -> int | None:
    """The first of the numbers below a count that has something, as all that follow do."""
    low, high = -1, 0
    while not has(high):
        if high == count - 1:
            return None
        low, high = high, min(2 * high + 1, count - 1)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if has(middle) else (middle, high)
    return high


def _widen(sides: Array, begin: Array) -> Array:
    """Limits of joints, wider where they have left them already as they begin, or can no longer keep them."""
    q, v, a = np.nan_to_num(begin)
    turned = v + a * abs(a) / (2.0 * np.abs(sides[3]).min(axis=0))  # speed when the acceleration is gone
    forced = np.array([[q, q], [v, turned], [a, a]])
    low, high = np.minimum(sides[:3, 0], forced.min(axis=1)), np.maximum(sides[:3, 1], forced.max(axis=1))
    return np.concatenate([np.stack([low, high], axis=1), sides[3:]])


@dataclass(frozen=True, eq=False)
class _Joints:
    """Some joints in n pieces of a time.

    Attributes
    ----------
    numbers : tuple of int
    piece : float
        Time of a piece [s].
    wanted : ndarray, shape (joints, n + 1)
        Positions.
    sides : ndarray, shape (4, 2, joints)
        Limits by `KINDS`.
    begin, end : ndarray, shape (3, joints)
        Positions, velocities and accelerations, NaN where these are free.
    braking : list of tuple of BrakingPlace
    rows : Rows
        Of what is left within pieces without them.
    """

    numbers: tuple[int, ...]
    piece: float
    wanted: Array
    sides: Array
    begin: Array
    end: Array
    braking: list[tuple[BrakingPlace, ...]]
    rows: Rows = Rows(np.zeros(0, dtype=np.int64), np.zeros((0, 4)), np.zeros(0))

    def solve(self, rounds: int = _ROUNDS) -> dict[int, Array]:
        """Positions and three derivatives, shape (4, n + 1), the last jerk twice, where there is a motion."""
        x, is_found = Chains(*self._programme(), self.rows).minimise()
        found = self._follow(x)
        left = self._violations(found, is_found)
        again = np.unique(left.at // found.shape[2]) if rounds > 1 else np.zeros(0, dtype=np.int64)
        is_found[again] = False
        rest = self._with(left, again).solve(rounds - 1) if len(again) else {}
        return rest | {k: found[i] for i, k in enumerate(self.numbers) if is_found[i]}

    def _with(self, left: Rows, places: IntArray) -> _Joints:
        """Some of the joints, with rows of what they leave."""
        rows = Rows.of([self.rows, left])
        joints, pieces = np.divmod(rows.at, self.wanted.shape[1])
        at, is_own = np.searchsorted(places, joints) * self.wanted.shape[1] + pieces, np.isin(joints, places)
        return replace(
            self,
            numbers=tuple(self.numbers[k] for k in places),
            wanted=self.wanted[places],
            sides=self.sides[..., places],
            begin=self.begin[:, places],
            end=self.end[:, places],
            braking=[self.braking[k] for k in places],
            rows=Rows(at[is_own], rows.entries[is_own], rows.most[is_own]),
        )

    def _programme(self) -> tuple[Array, Array, Array, Array, Array]:
        """What leads from time to time, weights, linear part, limits, and ends, by units."""
        count, length = self.wanted.shape
        units = self._units.T[:, None]  # joints, 1, 4
        weights, linear, given = np.zeros((3, count, length, 4))
        joints = np.arange(count)
        leads = np.stack([self._taylor(k, joints, np.full(count, self.piece)) for k in range(3)], axis=1)
        weights[..., 0], weights[..., 3] = 1.0, (_SMOOTH * self.piece**3 * units[..., 3] / units[..., 0]) ** 2
        linear[..., 0] = -self.wanted / units[..., 0]
        given[:], given[:, 0, :3], given[:, -1, :3] = np.nan, self.begin.T, self.end.T
        given[:, -1, 3] = 0.0  # no piece begins there
        given /= units
        sides = np.clip(self.sides.transpose(1, 2, 0)[:, :, None] / units, -_FAR, _FAR)
        sides = np.where(np.isnan(given), sides, given + np.array([-1.0, 1.0])[:, None, None, None])
        return leads, weights, linear, sides, given

    @cached_property
    def _units(self) -> Array:
        """Their limits, or about what values are where these are free, shape (4, joints)."""
        duration = self.piece * (self.wanted.shape[1] - 1)
        speed = np.maximum(np.abs(np.diff(self.wanted)).max(axis=1) / self.piece, _LEAST_SPEED)
        usual = np.array([speed * duration, speed, speed / duration, speed / duration**2])
        sizes = np.abs(self.sides).max(axis=1)
        return np.where(np.isfinite(sizes) & (sizes > 0.0), sizes, usual)

    def _taylor(self, order: int, joints: IntArray, spans: Array) -> Array:
        """Rows of a derivative some time [s] after the begin of pieces, by its unit, shape (k, 4)."""
        found = np.zeros((len(joints), 4))
        for k in range(order, 4):
            scale = (self._units[k] / self._units[order])[joints]
            found[:, k] = spans ** (k - order) / factorial(k - order) * scale
        return found

    def _follow(self, x: Array) -> Array:
        """What the jerks lead to, so that all is one motion to round-off, shape (joints, 4, n + 1)."""
        h, found = self.piece, x.transpose(0, 2, 1) * self._units.T[:, :, None]
        begin = self.begin.T
        found[:, :3, 0] = np.where(np.isfinite(begin), begin, found[:, :3, 0])
        found[:, 3, -1] = found[:, 3, -2]
        for k in (2, 1, 0):
            moves = sum(found[:, k + i, :-1] * h**i / factorial(i) for i in range(1, 4 - k))
            found[:, k, 1:] = found[:, k, :1] + np.cumsum(moves, axis=1)
        return found

    def _violations(self, found: Array, counts: BoolArray) -> Rows:
        """What motions that count leave within pieces."""
        signs = (-1.0, 1.0)
        braking = [(k, one) for k, own in enumerate(self.braking) if counts[k] for one in own]
        parts = [self._turns(found, counts, sign) for sign in signs]
        return Rows.of(parts + [self._too_fast(found, k, one, sign) for k, one in braking for sign in signs])

    def _turns(self, found: Array, counts: BoolArray, sign: float) -> Rows:
        """Speeds beyond a limit where they turn."""
        v, a, j = (found[:, k, :-1] for k in (1, 2, 3))
        side, unit = self.sides[1, int(sign > 0.0)], self._units[1]
        turns = (a * found[:, 2, 1:] < 0.0) & counts[:, None]
        spans = np.divide(-a, j, out=np.zeros_like(a), where=turns)
        over = sign * (v + a * spans / 2.0 - side[:, None])
        joints, pieces = np.nonzero(turns & (over > _LEFT * unit[:, None]))
        entries = sign * self._taylor(1, joints, spans[joints, pieces])
        return Rows(joints * found.shape[2] + pieces, entries, sign * (side / unit)[joints])

    def _too_fast(self, found: Array, k: int, place: BrakingPlace, sign: float) -> Rows:
        """Tangents where joint k is too fast before a limit of its position, at the worst time of pieces."""
        spans, limit = self.piece * _PLACES[:, None], place.upper if sign > 0.0 else place.lower
        x, v0, a, j = found[k, :, :-1]
        q, v = x + spans * (v0 + spans * (a / 2.0 + spans * j / 6.0)), v0 + spans * (a + spans * j / 2.0)
        braked = np.sqrt(2.0 * place.deceleration * np.maximum(sign * (limit - q), _LEAST_ROOM))
        over = sign * v - (braked - place.reserve)
        worst, units = over.argmax(axis=0), self._units[:, k]
        pieces = np.flatnonzero(over.max(axis=0) > _LEFT * units[1])
        at, joints = (worst[pieces], pieces), np.full(len(pieces), k)
        slopes = sign * place.deceleration / braked[at]
        of_speed, of_position = (self._taylor(i, joints, spans[worst[pieces], 0]) for i in (1, 0))
        entries = sign * of_speed + (slopes * units[0] / units[1])[:, None] * of_position
        most = (braked[at] - place.reserve + slopes * q[at]) / units[1]
        return Rows(k * found.shape[2] + pieces, entries, most)
