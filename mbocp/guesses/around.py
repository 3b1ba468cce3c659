"""A way around obstacles for a first guess: a path of lines in the configuration space, found by search.

Two trees of configurations grow from both ends towards random places and each other until they meet
(RRT-Connect); then corners are cut as long as the way stays clear. The same problem always has the same way.

References
----------
Kuffner, LaValle, "RRT-Connect: an efficient approach to single-query path planning", 2000.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.guesses.ways import Way, position_limits
from mbocp.problem import Problem
from mbocp.problem.clearance import Clearance
from mbocp.problem.near_pairs import MANY, near_pairs, with_pairs

__all__ = ["around", "near_the_way"]

_STEP = 0.15  # [rad, m] in the configuration space
_CHECKED = 8  # configurations of a step
_MOST = 4000  # steps of both trees
_CUTS = 150  # tries to cut a corner
_RESERVES = (0.03, 0.01, 0.0)  # [m] beyond the margins, the first with which a way is found
_NEAR = 1e-3  # [m] beyond a reserve: how near does not matter there
_FOUND: WeakKeyDictionary[Clearance, dict[tuple[bytes, bytes], Way | None]] = WeakKeyDictionary()
_PLACES, _ROUNDS = 60, 60  # of a way whose corners are rounded


def near_the_way(problem: Problem, qs: Array | None = None) -> Problem:
    """The problem with rows for what comes near the line, or the way around; itself where pairs are few.

    Parameters
    ----------
    qs : ndarray, shape (n, nq), optional
        Configurations of a motion that takes the place of the way.
    """
    clearance, robot = problem.clearance, problem.robot
    if clearance is None or clearance.num_pairs < MANY or problem.goals or robot.nc:
        return problem
    if qs is not None and qs.shape[1:] == (robot.nq,):
        return with_pairs(problem, near_pairs(clearance, qs))
    shares, q_start = np.linspace(0.0, 1.0, _PLACES), np.asarray(problem.q_start)
    way = around(problem)
    if way is None:
        found = _on_lines(robot.model, [q_start, *_stops(problem), np.asarray(problem.goal.q)], shares)
    else:
        found = way(q_start, shares)
    return with_pairs(problem, near_pairs(clearance, found))


def _stops(problem: Problem) -> list[Array]:
    return [np.asarray(point.via.goal.q) for point in problem.waypoints]


def around(problem: Problem) -> Way | None:
    """A way from start to goal that keeps all clearances; None where the line does, or none is found."""
    clearance = problem.clearance
    if clearance is None or not clearance.num_pairs or problem.robot.nc or problem.waypoints:
        return None
    ends = (np.asarray(problem.q_start).tobytes(), np.asarray(problem.goal.q).tobytes())
    known = _FOUND.setdefault(clearance, {})
    if ends not in known:
        known[ends] = _around(problem, clearance)
    return known[ends]


def _around(problem: Problem, clearance: Clearance) -> Way | None:
    room = _Room(problem, clearance)
    q_start, q_goal = np.asarray(problem.q_start), np.asarray(problem.goal.q)
    if room.is_free(q_start, q_goal, 0.0):
        return None
    at_ends = float(room.least(np.array([q_start, q_goal])).min())
    for wanted in _RESERVES:
        reserve = min(wanted, at_ends)
        path = _search(room, q_start, q_goal, reserve)
        if path is not None:
            return _way(problem, _rounded(room, _cut(room, path, reserve), reserve))
    return None


@dataclass(frozen=True, eq=False)
class _Room:
    """Where a robot may be."""

    problem: Problem
    clearance: Clearance

    def least(self, qs: Array, most: float = np.inf) -> Array:
        """Least clearance beyond its margin at each configuration, at most `most`, shape (n,) [m]."""
        return self.clearance.least(qs, most)

    def between(self, q0: Array, q1: Array, count: int) -> Array:
        """Configurations on the line, without its start, shape (count, nq)."""
        model = self.problem.robot.model
        return np.array([pin.interpolate(model, q0, q1, (k + 1) / count) for k in range(count)])

    def is_free(self, q0: Array, q1: Array, reserve: float) -> bool:
        """Whether the line keeps a reserve."""
        length = float(np.linalg.norm(self.problem.robot.difference(q0, q1)))
        count = _CHECKED * max(1, int(np.ceil(length / _STEP)))
        for part in np.array_split(self.between(q0, q1, count), count // _CHECKED):
            if self.least(part, reserve + _NEAR).min() < reserve:
                return False
        return True


def _search(room: _Room, q_start: Array, q_goal: Array, reserve: float) -> list[Array] | None:
    """Corners of a way, both ends included; None if none is found."""
    rng = np.random.default_rng(0)
    sample = _sampler(room.problem, rng)
    trees = [_Tree([q_start], [-1]), _Tree([q_goal], [-1])]
    for turn in range(_MOST):
        mine, other = trees[turn % 2], trees[1 - turn % 2]
        new = mine.grow(room, sample(), reserve)
        if new is None:
            continue
        target = mine.places[new]
        while True:
            reached = other.grow(room, target, reserve)
            if reached is None:
                break
            if np.allclose(other.places[reached], target, rtol=0.0, atol=1e-12):
                path = [*mine.way_to(new), *other.way_to(reached)[::-1][1:]]
                return path if mine is trees[0] else path[::-1]
            if len(other.places) > _MOST:
                return None
    return None


@dataclass(eq=False)
class _Tree:
    places: list[Array]
    parents: list[int]

    def grow(self, room: _Room, target: Array, reserve: float) -> int | None:
        """One step from the nearest place towards a target; None where it is not free."""
        robot = room.problem.robot
        away = np.array(self.places) - target  # near enough to the distance on the group to choose by
        nearest = int(np.einsum("ij,ij->i", away, away).argmin())
        ahead = np.asarray(robot.difference(self.places[nearest], target))
        length = float(np.linalg.norm(ahead))
        there = target
        if length > _STEP:
            there = np.asarray(robot.integrate(self.places[nearest], ahead * _STEP / length))
        if room.least(room.between(self.places[nearest], there, _CHECKED), reserve + _NEAR).min() < reserve:
            return None
        self.places.append(there)
        self.parents.append(nearest)
        return len(self.places) - 1

    def way_to(self, place: int) -> list[Array]:
        """Places from the root to one."""
        found = []
        while place >= 0:
            found.append(self.places[place])
            place = self.parents[place]
        return found[::-1]


def _sampler(problem: Problem, rng: np.random.Generator) -> Callable[[], Array]:
    """Random configurations within the limits, about the two ends where there are none."""
    robot = problem.robot
    q0, q1 = np.asarray(problem.q_start), np.asarray(problem.goal.q)
    ahead = np.asarray(robot.difference(q0, q1))
    size = np.maximum(np.abs(ahead), float(np.abs(ahead).max(initial=0.0)) / 2.0) + 0.5
    lower, upper = position_limits(problem)

    def sample() -> Array:
        middle = robot.integrate(q0, ahead * rng.uniform())
        q = np.array(robot.integrate(middle, rng.uniform(-1.0, 1.0, robot.nv) * size))
        if robot.is_vector_space:
            q = np.clip(q, lower, upper)
        return q

    return sample


def _cut(room: _Room, path: list[Array], reserve: float) -> list[Array]:
    """The way with corners cut."""
    rng = np.random.default_rng(1)
    for _ in range(_CUTS):
        if len(path) < 3:
            break
        a, b = sorted(rng.choice(len(path), 2, replace=False).tolist())
        if b - a > 1 and room.is_free(path[a], path[b], reserve):
            path = [*path[: a + 1], *path[b:]]
    return path


def _rounded(room: _Room, path: list[Array], reserve: float) -> list[Array]:
    """The way as many places, each drawn to the middle of its neighbours as long as all stay clear."""
    robot = room.problem.robot
    model = robot.model
    shares = np.linspace(0.0, 1.0, _PLACES)
    places = _on_lines(model, path, shares)
    for _ in range(_ROUNDS):
        middles = [pin.interpolate(model, a, b, 0.5) for a, b in zip(places[:-2], places[2:], strict=True)]
        inner = [pin.interpolate(model, q, m, 0.5) for q, m in zip(places[1:-1], middles, strict=True)]
        moved = np.array([places[0], *inner, places[-1]])
        if room.least(moved).min() < min(reserve, float(room.least(places).min())):
            break
        places = moved
    return list(places)


def _way(problem: Problem, path: list[Array]) -> Way:
    """Configurations by the share of the length; it begins where it is told."""
    model = problem.robot.model
    return lambda q_start, shares: _on_lines(model, [np.asarray(q_start), *path[1:]], shares)


def _on_lines(model: pin.Model, corners: list[Array], shares: Array) -> Array:
    """Configurations by their share of the length of a way of lines."""
    legs = list(pairwise(corners))
    lengths = [float(np.linalg.norm(pin.difference(model, a, b))) for a, b in legs]
    at = np.concatenate([[0.0], np.cumsum(lengths)]) / max(sum(lengths), 1e-300)
    found = []
    for share in shares:
        leg = int(np.clip(np.searchsorted(at, share, side="right") - 1, 0, len(legs) - 1))
        part = (share - at[leg]) / max(float(at[leg + 1] - at[leg]), 1e-300)
        found.append(pin.interpolate(model, *legs[leg], float(np.clip(part, 0.0, 1.0))))
    return np.array(found)
