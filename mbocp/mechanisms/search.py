"""Search for a configuration that a mechanism with closed loops can reach from a pose.

The straight way is `mbocp.robot.loops.projection.follow`. Where it gets stuck, there may be a way round: a
mechanism with one degree of freedom is led along its curve in both directions, others on random walks.
"""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp._linear import null_space
from mbocp._tolerances import ARRIVAL_TOLERANCE, RANK_TOLERANCE
from mbocp.robot import Robot
from mbocp.robot.loops.projection import follow, gauss_newton, violations

_STRIDE = 0.15  # [rad, m] of the joint that moves most
_CURVE_TURNS = 1.5  # [2 pi rad, 2 pi m] a curve is followed beyond the distance of the target
_NUM_WALKS, _MIN_STRIDES, _MAX_STRIDES = 16, 3, 15  # random walks, and the strides of each
_LARGE = 12  # velocity components beyond which there are half as many: a stride takes milliseconds
_ARRIVAL_RADIUS = 0.6  # [rad, m] nearer than this, the straight way to the target is tried
_BRANCH_TOLERANCE = 0.1  # a direction with a smaller singular value may be a branch of its own


def search(robot: Robot, q_start: Array, target: Array, wanted: BoolArray) -> Array | None:
    """Reachable configuration with the wanted components of a target, its loops closed.

    Parameters
    ----------
    q_start : ndarray, shape (nq,)
        Configuration that closes the loops.
    target : ndarray, shape (nq,)
        Configuration [m, rad]; only its wanted components matter.
    wanted : ndarray of bool, shape (nv,)
        Velocity components of whole joints.

    Returns
    -------
    q : ndarray, shape (nq,), or None
        None if the search finds no path. With one degree of freedom and no singular pose on its curve there
        is none, within one and a half turns.
    """
    rng = np.random.default_rng(0)
    basis = null_space(robot.constraint_jacobian(q_start), RANK_TOLERANCE)
    places = [q_start]
    if basis.shape[1] == 1:
        found, places = _along_curve(robot, q_start, basis[:, 0], target, wanted)
        if found is not None or not places:
            return found
    for _ in range(_NUM_WALKS if robot.nv <= _LARGE else _NUM_WALKS // 2):
        q = places[int(rng.integers(len(places)))]
        directions = _directions(robot, q)
        ahead = directions @ rng.standard_normal(directions.shape[1])
        walked = _walk(robot, q, ahead, int(rng.integers(_MIN_STRIDES, _MAX_STRIDES)))
        reached = follow(robot, walked[-1], target, wanted, max_kicks=0)  # the next walk is a better one
        if distance(robot, reached, target, wanted) <= ARRIVAL_TOLERANCE:
            return reached
        places = places if basis.shape[1] == 1 else [*places, walked[-1]]
    return None


def _along_curve(
    robot: Robot, q_start: Array, ahead: Array, target: Array, wanted: BoolArray
) -> tuple[Array | None, list[Array]]:
    """Configuration at the target, or None, along the one curve; and the poses where curves branch off."""
    size = distance(robot, q_start, target, wanted)
    strides = int((size + 2.0 * np.pi * _CURVE_TURNS) / _STRIDE)
    places: list[Array] = []
    for direction in (ahead, -ahead):
        path = _walk(robot, q_start, direction, strides)
        away = np.array([distance(robot, q, target, wanted) for q in path])
        is_minimum = np.r_[True, away[1:] <= away[:-1]] & np.r_[away[:-1] <= away[1:], True]
        for node in np.flatnonzero(is_minimum & (away < _ARRIVAL_RADIUS)):
            reached = follow(robot, path[node], target, wanted)
            if distance(robot, reached, target, wanted) <= ARRIVAL_TOLERANCE:
                return reached, places
        places += [q for q in path if _directions(robot, q).shape[1] > 1]
        if len(path) <= strides and distance(robot, path[-1], q_start, np.ones_like(wanted)) < _STRIDE:
            break  # the curve is closed
    return None, places


def _walk(robot: Robot, q: Array, ahead: Array, strides: int) -> list[Array]:
    """Configurations along the constraints from q, straight on, until a step fails or the path closes."""
    path, everything = [q], np.ones(robot.nv, dtype=np.bool_)
    for _ in range(strides):
        moved = _stride(robot, path[-1], ahead)
        if moved is None:
            break
        ahead = robot.difference(path[-1], moved)
        path.append(moved)
        if len(path) > _MIN_STRIDES and distance(robot, moved, q, everything) < 0.6 * _STRIDE:
            break
    return path


def _stride(robot: Robot, q: Array, ahead: Array) -> Array | None:
    """Configuration one stride ahead along the constraints, or a shorter stride; None if none succeeds."""
    directions = _directions(robot, q)
    along = directions @ (directions.T @ ahead)
    size = float(np.abs(along).max(initial=0.0))
    if size == 0.0:
        return None
    everything = np.ones(robot.nv, dtype=np.bool_)
    for length in _STRIDE / 4.0 ** np.arange(4):
        step = along * (length / size)
        guess = robot.integrate(q, step)
        found = gauss_newton(robot, guess, everything, robot.kept_rows)
        corrected = float(np.abs(robot.difference(guess, found)).max())
        if corrected <= 0.5 * length and not violations(robot, found):
            return found
    return None


def _directions(robot: Robot, q: Array) -> Array:
    """Directions along the constraints, shape (nv, any); near a singular pose also those of its branches."""
    return null_space(robot.constraint_jacobian(q), _BRANCH_TOLERANCE)


def distance(robot: Robot, q: Array, target: Array, wanted: BoolArray) -> float:
    """Largest way of a wanted component from one configuration to another [rad, m]."""
    return float(np.abs(robot.difference(q, target)[wanted]).max(initial=0.0))
