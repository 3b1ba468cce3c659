"""A way past obstacles that move, for a first guess: configurations by the time, found by search.

Two trees of configurations with times grow, one from the start and later, one from the goal at the end and
earlier, towards random places and each other until they meet (RRT-Connect). No edge is faster than some
multiple of the straight line's mean rate. The same problem always has the same way.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mbocp._arrays import Array
from mbocp.guesses.ways import Way
from mbocp.problem import Problem
from mbocp.problem.obstacles.clearance import Clearance
from mbocp.robot.joints import joint_kind

_RESERVES = (0.03, 0.01, 0.0)  # [m] beyond the margins, the first with which a way is found
_TREE = 1500  # configurations that are tried with each
_STEP, _RESOLUTION = 0.1, 0.01  # of the duration: of an edge, and between places of it that are looked at
_FASTER = 4.0  # times the mean rate of the line
_AROUND = 1.0  # [rad, m] that random places are from the line at least
_CUTS, _ROUNDS, _PLACES = 150, 40, 81


def blend(shares: Array) -> Array:
    """Shares of a way by those of the time, from rest to rest, with no acceleration at the ends."""
    return shares**3 * (10 - 15 * shares + 6 * shares**2)


def way_in_time(problem: Problem, limits: Array, seed: int) -> Way | None:
    """A way that keeps all clearances by the time of the guess; None where none is found.

    Parameters
    ----------
    problem : Problem
        Of a robot without joints whose configurations are no vectors: others have none.
    limits : ndarray, shape (2, nq)
    seed : int
    """
    clearance, model = problem.clearance, problem.robot.model
    if clearance is None or not all(joint_kind(model, j).is_vector for j in range(1, model.njoints)):
        return None
    ends = np.array([problem.q_start, problem.goal.q])
    for reserve in _RESERVES:
        search = _Search(clearance, problem.duration, ends, limits, reserve, np.random.default_rng(seed))
        path = search.run()
        if path is not None:
            return _by_time(search.round_corners(path))
    return None


def _by_time(places: Array) -> Way:
    """The way of configurations at equal shares of the time; ways count shares as `blend` does."""
    times = np.linspace(0.0, 1.0, len(places))

    def way(q_start: Array, shares: Array) -> Array:
        at = np.interp(shares, blend(times), times)
        found = np.column_stack([np.interp(at, times, column) for column in places.T])
        return found + (1.0 - shares)[:, None] * (np.asarray(q_start) - places[0])

    return way


@dataclass(eq=False)
class _Tree:
    """Places, a configuration and a share of the time each, and the number of the one before each."""

    places: list[Array]
    before: list[int] = field(default_factory=lambda: [-1])

    def path(self, k: int) -> list[Array]:
        """From its root to a place."""
        found = []
        while k >= 0:
            found.append(self.places[k])
            k = self.before[k]
        return found[::-1]


@dataclass(eq=False)
class _Search:
    """Two trees that look for each other.

    Attributes
    ----------
    clearance : Clearance
    duration : float
        [s].
    ends, limits : ndarray, shapes (2, nq)
    reserve : float
        Beyond all margins [m].
    rng : np.random.Generator
    tries : int
    """

    clearance: Clearance
    duration: float
    ends: Array
    limits: Array
    reserve: float
    rng: np.random.Generator
    tries: int = 0

    @property
    def _most(self) -> float:
        """Rate of edges, by the share of the time."""
        return _FASTER * max(float(np.linalg.norm(self.ends[1] - self.ends[0])), _AROUND)

    def run(self) -> Array | None:
        """Places from start to goal; None where none are found."""
        start, goal = np.append(self.ends[0], 0.0), np.append(self.ends[1], 1.0)
        if not self._is_clear(np.array([start, goal])):
            return None
        trees = [_Tree([start]), _Tree([goal])]
        sides, around = np.sort(self.ends, axis=0), max(_AROUND, self._most / (2.0 * _FASTER))
        low = np.maximum(sides[0] - around, self.limits[0])
        high = np.minimum(sides[1] + around, self.limits[1])
        while sum(len(tree.places) for tree in trees) < _TREE and self.tries < 4 * _TREE:
            for ahead, (mine, other) in enumerate((trees, trees[::-1])):
                wanted = np.append(self.rng.uniform(low, high), self.rng.uniform())
                k = self._extend(mine, wanted, is_later=not ahead)
                if k is None:
                    continue
                reached = self._connect(other, mine.places[k], is_later=bool(ahead))
                if reached is not None:
                    legs = mine.path(k), other.path(reached)[::-1]
                    path = np.array([*legs[0], *legs[1][1:]])
                    return path[::-1] if ahead else path
        return None

    def _extend(self, tree: _Tree, wanted: Array, *, is_later: bool) -> int | None:
        """Add a place on the way to another one; return its number, None where something is in the way."""
        self.tries += 1
        steps = wanted - np.array(tree.places)
        ahead = steps[:, -1] if is_later else -steps[:, -1]
        far = np.linalg.norm(steps[:, :-1], axis=1)
        cost = np.where(far <= self._most * ahead, far / self._most + ahead, np.inf)
        k = int(cost.argmin())
        if not np.isfinite(cost[k]) or cost[k] == 0.0:
            return None
        is_near = ahead[k] <= _STEP
        place = wanted if is_near else tree.places[k] + _STEP / ahead[k] * steps[k]
        if not self._is_free(tree.places[k], place):
            return None
        tree.places.append(place)
        tree.before.append(k)
        return len(tree.places) - 1

    def _connect(self, tree: _Tree, wanted: Array, *, is_later: bool) -> int | None:
        """Grow a tree to a place; return the number of it, None where something is in the way."""
        while True:
            k = self._extend(tree, wanted, is_later=is_later)
            if k is None or np.array_equal(tree.places[k], wanted):
                return k

    def _is_free(self, a: Array, b: Array) -> bool:
        far = max(abs(b[-1] - a[-1]), float(np.linalg.norm(b[:-1] - a[:-1])) / self._most)
        shares = np.linspace(0.0, 1.0, 2 + int(far / _RESOLUTION))[1:, None]
        return self._is_clear(a + shares * (b - a))

    def _is_clear(self, places: Array) -> bool:
        ts, most = self.duration * places[:, -1], self.reserve + 1e-3
        return bool(self.clearance.least(places[:, :-1], most, ts).min() >= self.reserve)

    def round_corners(self, path: Array) -> Array:
        """Configurations at equal shares of the time, with corners cut and drawn towards their neighbours."""
        for _ in range(_CUTS):
            times = np.sort(self.rng.uniform(size=2))
            a, b = (self._at(path, t) for t in times)
            is_slow = np.linalg.norm(b[:-1] - a[:-1]) <= self._most * (b[-1] - a[-1])
            if is_slow and self._is_free(a, b):
                path = np.vstack([path[path[:, -1] < times[0]], a, b, path[path[:, -1] > times[1]]])
        times = np.linspace(0.0, 1.0, _PLACES)
        places = np.array([self._at(path, t) for t in times])
        for _ in range(_ROUNDS):
            moved = places.copy()
            moved[1:-1] = places[1:-1] / 2.0 + (places[:-2] + places[2:]) / 4.0
            if not self._is_clear(moved):
                break
            places = moved
        return places[:, :-1]

    @staticmethod
    def _at(path: Array, share: float) -> Array:
        return np.array([*(np.interp(share, path[:, -1], column) for column in path[:, :-1].T), share])
