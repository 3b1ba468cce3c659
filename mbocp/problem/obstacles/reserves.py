"""Rows for what comes near, and more rows and more room for motions that touch something between nodes.

A robot of sixty spheres among twenty obstacles has a thousand pairs, of which a motion comes near a few
dozen. The others have no rows as long as no motion comes near them, too.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array
from mbocp.problem.obstacles.approach import Approach, poses_between
from mbocp.problem.obstacles.clearance import Clearance
from mbocp.robot.nodes import along, between

if TYPE_CHECKING:
    from mbocp.problem.problem import Problem


_RESERVE = 1e-3  # [m] beyond what a way lacks between nodes
_SPARE = 2e-3  # [m] beyond what a motion lacks there: the next one cuts another corner
_MOST = 0.05  # [m]
_FIRST = 5e-3  # [m] that is worth having before anything is known
_CLOSER = 2.0  # times what a way cuts off: the motion comes nearer than that
_EXACT = 1e-4  # [m]: spheres that stick out no farther are the links' shapes
MANY = 48  # pairs, from which on they are chosen
_NEAR, _BESIDE = 0.05, 0.2  # [m]
_MOST_PAIRS = 64  # chosen pairs at first
_BETWEEN = 4  # configurations of a step
_MISSED = 0.01  # [m] from what is missing, what is taken, too


def with_first_reserve(problem: Problem, ts: Array, qs: Array) -> Problem:
    """The problem with room for the corners that steps as long as those of a way cut off.

    Only where spheres are the shapes of their links: others are larger than these, which is room enough.

    Parameters
    ----------
    ts, qs : ndarray, shapes (n,) and (n, nq)
        Times [s] and configurations of a way, one for each node.
    """
    rows = rows_of(problem)
    if rows is None or not _is_exact(rows):
        return problem
    middles = between(problem.robot, qs[:-1], qs[1:], np.full(len(qs) - 1, 0.5))
    half, wanted = (ts[:-1] + ts[1:]) / 2.0, np.full(rows.num_pairs, _RESERVE)
    pairs = np.flatnonzero(rows.nearest_of_pairs(qs, _BESIDE, ts) < _BESIDE)
    values = rows.pair_values(qs, ts=ts, pairs=pairs)
    cut = np.minimum(values[:-1], values[1:]) - rows.pair_values(middles, ts=half, pairs=pairs)
    wanted[pairs] += _CLOSER * np.maximum(cut.max(axis=0), 0.0)
    return _with(problem, rows, rows.chosen, np.maximum(rows.reserves, np.minimum(wanted, _FIRST)))


def room_of(problem: Problem) -> Array:
    """What the row of each pair keeps beyond its margin, shape (num_pairs,) [m]; -1: it has no row."""
    rows = rows_of(problem)
    if rows is None:
        return np.zeros(0)
    if rows.chosen is None:
        return rows.reserves
    found = np.full(rows.num_pairs, -1.0)
    found[list(rows.chosen)] = rows.reserves[list(rows.chosen)]
    return found


def with_room(problem: Problem, room: Array, ts: Array, qs: Array) -> Problem:
    """The problem with rows and room as `room_of` has them, and rows for what a motion touches beside."""
    rows = rows_of(problem)
    if rows is None:
        return problem
    has_all = bool((room >= 0.0).all())
    chosen = None if has_all else tuple(np.flatnonzero(room >= 0.0).tolist())
    found = _with(problem, rows, chosen, np.maximum(room, 0.0))
    missing = find_missing_pairs(found, ts, qs)
    return with_pairs(found, {*(chosen or ()), *missing}) if missing else found


def with_rows_and_room(
    problem: Problem, t: Array, qs: Array, vs: Array, touches: Mapping[str, Approach]
) -> tuple[Problem, bool] | None:
    """The problem with rows for what a motion touches that had none, and room where it cuts corners.

    Parameters
    ----------
    problem : Problem
    t : ndarray, shape (N + 1,)
        [s].
    qs, vs : ndarray, shapes (N + 1, nq) and (N + 1, nv)
    touches : mapping of str to Approach
        Where things are deepest in each other, see `mbocp.problem.obstacles.approach.touches_along`.

    Returns
    -------
    tuple of (Problem, bool), optional
        Whether there are more rows than before; None if nothing can be done, or needs to be.
    """
    rows = rows_of(problem)
    if rows is None or not np.isfinite(qs).all():
        return None
    missing, reserve, chosen = set(find_missing_pairs(problem, t, qs, vs)), rows.reserves, rows.chosen
    if touches:
        more = _shortfalls(rows, t, qs, vs, touches)
        missing |= set(np.flatnonzero(more).tolist())
        # With more it jumps over something: that takes more steps.
        reserve = np.where(reserve + more <= _MOST, reserve + more, reserve)
    has_more_rows = chosen is not None and not missing <= set(chosen)
    found = _with(problem, rows, None if chosen is None else tuple({*chosen, *missing}), reserve)
    larger = rows_of(found)
    if (
        not has_more_rows
        and larger is not None
        and np.allclose(larger.reserves, rows.reserves, rtol=0.0, atol=1e-9)
    ):
        return None
    return found, has_more_rows


def _shortfalls(rows: Clearance, t: Array, qs: Array, vs: Array, touches: Mapping[str, Approach]) -> Array:
    """What each pair is short of between nodes, shape (num_pairs,) [m]; 0: nothing.

    A pair that has had no row is short of what the motion cuts off between nodes: its row keeps the rest.
    """
    times, sampled = poses_between(rows.robot, t, qs, vs)
    least = rows.nearest_of_pairs(sampled, _MOST, times)
    more, is_near = np.zeros(rows.num_pairs), least < _MOST
    has_row = np.ones(rows.num_pairs, dtype=np.bool_)
    cut = np.zeros(rows.num_pairs)
    if rows.chosen is not None:
        has_row[:] = False
        has_row[list(rows.chosen)] = True
        cut = np.maximum(rows.nearest_of_pairs(qs, _MOST, t) - least, 0.0)
    for group, pair in enumerate(rows.link_pairs):
        touch = touches.get(" and ".join(rows.names_of(pair)))
        meant = np.flatnonzero(is_near & (rows.groups == group))
        if touch is None or not meant.size:
            continue
        nearest, left = meant[least[meant] < least[meant].min() + _RESERVE], 0.0
        if rows.overlaps[meant].any():
            there = sampled[[times.searchsorted(touch.time)]]
            values = rows.pair_values(there, ts=np.array([touch.time]), pairs=meant)[0]
            values -= (rows.margins + rows.reserves)[meant]
            nearest, left = meant[[values.argmin()]], max(float(values.min()), 0.0)
        more[nearest] = np.where(has_row, left - touch.distance, cut)[nearest] + _SPARE
    if _is_exact(rows):
        lack = _RESERVE + np.where(has_row, -least, cut)
        more = np.maximum(more, np.where(least < 0.0, lack, 0.0))
    return more


def largest_reserve(problem: Problem) -> float:
    """Of all pairs that have rows [m]."""
    rows = rows_of(problem)
    if rows is None:
        return 0.0
    kept = rows.reserves if rows.chosen is None else rows.reserves[list(rows.chosen)]
    return float(kept.max(initial=0.0))


def _is_exact(rows: Clearance) -> bool:
    """Whether spheres are the shapes of the links."""
    outside = np.array([link.sticks_out for link in rows.robot.collision_spheres])
    return bool((np.isnan(outside) | (outside <= _EXACT)).all())


def _with(problem: Problem, rows: Clearance, chosen: tuple[int, ...] | None, reserve: Array) -> Problem:
    """The problem with these rows and room, but for what the goal has not; it is not checked again."""
    at_end = None if problem.timeline.has_free_lengths else np.array([problem.duration])
    room = rows.pair_values(np.asarray(problem.goal.q)[None], ts=at_end)[0] - rows.margins
    goal_room = np.maximum(room - _RESERVE, 0.0) if problem.goal.q_active.all() else None
    larger = rows.of_pairs(chosen, reserve, goal_room)
    return replace(problem, path=tuple(larger if c is rows else c for c in problem.path))


def near_pairs(clearance: Clearance, ts: Array, qs: Array) -> tuple[int, ...]:
    """Pairs that come near along some configurations at their times, and others as far as there are rows."""
    least = clearance.nearest_of_pairs(qs, _BESIDE, ts)
    nearest = np.argsort(least, kind="stable").tolist()
    count = int(np.clip(np.count_nonzero(least < _NEAR), 1, _MOST_PAIRS))
    return clearance.fill(nearest[:count] or [0], nearest[count : np.count_nonzero(least < _BESIDE)])


def find_missing_pairs(problem: Problem, ts: Array, qs: Array, vs: Array | None = None) -> tuple[int, ...]:
    """Pairs without rows that touch along the nodes of a motion, and others near it; none if none does."""
    clearance, rows = problem.clearance, rows_of(problem)
    if clearance is None or rows is None or rows.chosen is None or not np.isfinite(qs).all():
        return ()
    first = np.repeat(np.arange(len(qs) - 1), _BETWEEN)
    shares = np.tile(np.arange(_BETWEEN) / _BETWEEN, len(qs) - 1)
    times = np.append((1.0 - shares) * ts[first] + shares * ts[first + 1], ts[-1])
    sampled = along(problem.robot, ts, qs, vs, times)
    least = clearance.nearest_of_pairs(sampled, _NEAR, times)
    least[list(rows.chosen)] = np.inf
    if least.min(initial=np.inf) >= 0.0:
        return ()
    order = np.argsort(least, kind="stable")
    ends = [np.count_nonzero(least < limit) for limit in (_MISSED, _NEAR)]
    every = rows.fill([*rows.chosen, *order[: ends[0]].tolist()], order[ends[0] : ends[1]].tolist())
    return tuple(set(every) - set(rows.chosen))


def with_pairs(problem: Problem, chosen: Collection[int]) -> Problem:
    """The problem with rows for some of its pairs; it is not checked again."""
    rows = rows_of(problem)
    if rows is None:
        return problem
    larger = rows.of_pairs(tuple(chosen), rows.reserve, rows.goal_room)
    path = tuple(larger if c is rows else c for c in problem.path)
    return replace(problem, path=path)


def rows_of(problem: Problem) -> Clearance | None:
    """The clearance whose rows a problem has."""
    return next((c for c in problem.path if isinstance(c, Clearance)), None)
