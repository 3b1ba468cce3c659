"""A way around obstacles for a first guess: a path of lines in the configuration space, found by search.

Two trees of configurations grow from both ends towards random places and each other until they meet
(RRT-Connect); then corners are cut as long as the way stays clear. The same problem always has the same way.

References
----------
Kuffner, LaValle, "RRT-Connect: an efficient approach to single-query path planning", 2000.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from mbocp._arrays import Array
from mbocp.guesses.in_time import blend, way_in_time
from mbocp.guesses.ways import Way, position_limits, read_given_way, straight, through
from mbocp.problem import Problem
from mbocp.problem.obstacles.clearance import Clearance
from mbocp.problem.obstacles.pair_clearances import WaySize
from mbocp.problem.obstacles.reserves import MANY, near_pairs, with_first_reserve, with_pairs
from mbocp.robot import Robot
from mbocp.robot.joints import configuration_slice, joint_kind
from mbocp.robot.nodes import between

_SIZE = WaySize(step=0.2, resolution=0.02, most=10_000, cuts=300)  # [rad, m] in the configuration space
_LONGER = 40_000  # configurations of a second search, where the first finds nothing ...
_WIDER = 2.0  # ... among places that are so many times as far away
_AROUND = 0.5  # [rad, m] from the line, beside what it is long
_RESERVES = (0.03, 0.01, 0.0)  # [m] beyond the margins, the first with which a way is found ...
_QUICK = 3000  # ... in so many configurations, but for the last
_NEAR = 1e-3  # [m] beyond a reserve: how near does not matter there
_FOUND: WeakKeyDictionary[Clearance, dict[tuple[bytes, float, int], Way | None]] = WeakKeyDictionary()
_PLACES, _ROUNDS = 60, 60  # of a way whose corners are rounded


def near_the_way(problem: Problem, ts: Array | None = None, qs: Array | None = None) -> Problem:
    """The problem with rows for what comes near the line, or the way around; itself where pairs are few.

    Parameters
    ----------
    ts, qs : ndarray, shapes (n,) and (n, nq), optional
        Times [s] and configurations of a motion that takes the place of the way.
    """
    clearance, robot = problem.clearance, problem.robot
    if clearance is None or clearance.num_pairs < MANY or problem.goals or robot.nc:
        return problem
    if qs is not None and ts is not None and qs.shape[1:] == (robot.nq,):
        return with_pairs(problem, near_pairs(clearance, ts, qs))
    shares, q_start = np.linspace(0.0, 1.0, problem.num_steps + 1), np.asarray(problem.q_start)
    ts, shares = problem.duration * shares, blend(shares)
    stops = [np.asarray(point.via.goal.q) for point in problem.timeline.waypoints]
    corners = [*stops, np.asarray(problem.goal.q)]
    found = (read_given_way(problem) or around(problem) or through(robot, corners))(q_start, shares)
    return with_first_reserve(with_pairs(problem, near_pairs(clearance, ts, found)), ts, found)


def around(problem: Problem, seed: int = 0) -> Way | None:
    """A way from start to goal that keeps all clearances; None where the line does, or none is found.

    Other seeds have other ways, even where the line is clear. Where obstacles move, it is a way by the time.
    """
    clearance = problem.clearance
    if clearance is None or not may_have_ways(problem):
        return None
    ends = np.append(problem.q_start, problem.goal.q)
    key = (ends.tobytes(), problem.duration if clearance.movers else 0.0, seed)
    known = _FOUND.setdefault(clearance, {})
    if key not in known:
        known[key] = _find_way(problem, clearance, seed)
    return known[key]


def ways_around(problem: Problem, count: int) -> Iterator[tuple[str, Way]]:
    """Ways around obstacles that the first `count` other random numbers lead to, each with its words."""
    for seed in range(1, 1 + count):
        way = around(problem, seed)
        if way is None:
            return
        yield f"way {1 + seed} around obstacles", way


def may_have_ways(problem: Problem) -> bool:
    """Whether ways around obstacles are looked for."""
    clearance = problem.clearance
    has_pairs = clearance is not None and clearance.num_pairs > 0
    return has_pairs and not (problem.robot.nc or problem.timeline.waypoints)


def _find_way(problem: Problem, clearance: Clearance, seed: int) -> Way | None:
    ends = np.array([problem.q_start, problem.goal.q])
    if not seed and _is_free(problem, clearance, ends):
        return None
    ranges = _ranges(problem)
    if clearance.movers:
        return way_in_time(problem, ranges[:2], seed)
    at_ends = float(clearance.least(ends).min())
    *larger, least = dict.fromkeys(min(wanted, at_ends) for wanted in _RESERVES)
    quick, wider = replace(_SIZE, most=_QUICK), np.vstack([ranges[:2], _WIDER * ranges[2]])
    searches = [*((reserve, ranges, quick) for reserve in larger), (least, ranges, _SIZE)]
    if not seed:
        searches.append((least, wider, replace(_SIZE, most=_LONGER)))
    for reserve, within, size in searches:
        path = clearance.way(ends, within, reserve, seed, size)
        if path is not None:
            return through(problem.robot, _round(problem.robot, clearance, path, reserve)[1:])
    return None


def has_no_way(problem: Problem) -> bool:
    """Whether something is in the way of the line, and no way around it has been found."""
    clearance = problem.clearance
    if clearance is None or problem.timeline.waypoints or problem.goals or problem.robot.nc:
        return False
    if clearance.movers:  # with another duration there may be one
        return False
    return around(problem) is None and not _is_free(
        problem, clearance, np.array([problem.q_start, problem.goal.q])
    )


def _is_free(problem: Problem, clearance: Clearance, ends: Array) -> bool:
    """Whether the line keeps all margins."""
    length = float(np.linalg.norm(problem.robot.difference(*ends)))
    shares = np.linspace(0.0, 1.0, 2 + int(length / _SIZE.resolution))
    ts = problem.duration * shares
    return bool(clearance.least(straight(problem)(ends[0], blend(shares)), _NEAR, ts).min() >= 0.0)


def _ranges(problem: Problem) -> Array:
    """Limits of configurations, and how far from the line random ones are, shape (3, nq)."""
    robot = problem.robot
    found = np.array([np.full(robot.nq, -np.inf), np.full(robot.nq, np.inf), np.full(robot.nq, _AROUND)])
    ahead = np.abs(np.asarray(problem.goal.q) - np.asarray(problem.q_start))
    size = np.maximum(ahead, float(ahead.max(initial=0.0)) / 2.0) + _AROUND
    lower, upper = position_limits(problem)
    for joint in range(1, robot.model.njoints):
        if joint_kind(robot.model, joint).is_vector:
            numbers = configuration_slice(robot.model, joint)
            found[0, numbers], found[1, numbers] = lower[numbers], upper[numbers]
            found[2, numbers] = size[numbers]
    return found


def _round(robot: Robot, clearance: Clearance, path: Array, reserve: float) -> Array:
    """The way as many places, each drawn to the middle of its neighbours as long as all stay clear."""
    places, half = (
        through(robot, path[1:])(path[0], np.linspace(0.0, 1.0, _PLACES)),
        np.full(_PLACES - 2, 0.5),
    )
    known = float(clearance.least(places, reserve + _NEAR).min())
    for _ in range(_ROUNDS):
        inner = between(robot, places[1:-1], between(robot, places[:-2], places[2:], half), half)
        moved = np.vstack([places[:1], inner, places[-1:]])
        least = float(clearance.least(moved, reserve + _NEAR).min())
        if least < min(reserve, known):
            break
        places, known = moved, least
    return places
