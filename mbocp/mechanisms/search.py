"""Search for a configuration that a mechanism with closed loops can reach from a pose.

The straight way is `mbocp.robot.loops.projection.follow`. Where it gets stuck, there may be a way round: a
mechanism with one degree of freedom is led along its curve in both directions, others on random walks.
"""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp._linear import null_space
from mbocp.robot import Robot
from mbocp.robot.loops.projection import follow, gauss_newton, violations

__all__ = ["search"]

_STRIDE = 0.15  # [rad, m] of the joint that moves most
_TURNS = 1.5  # how far a curve is followed [2 pi rad, 2 pi m], beyond the distance of the target
_WALKS, _FEWEST, _MOST = 16, 3, 15  # of the search that is not along one curve, and strides of each
_NEAR = 0.6  # [rad, m] from where it is tried to arrive
_ARRIVED = 1e-6  # [rad, m]
_LOOSE = 0.1  # singular values below: a way on that may be a branch of its own


def search(robot: Robot, q_start: Array, target: Array, wanted: BoolArray) -> Array | None:
    """Configuration with the wanted components of a target that the mechanism reaches with its loops closed.

    Parameters
    ----------
    q_start : ndarray, shape (nq,)
        It closes the loops.
    target : ndarray, shape (nq,)
    wanted : ndarray of bool, shape (nv,)
        Components of whole joints.

    Returns
    -------
    q : ndarray, shape (nq,), or None
        None if no way is found. For one degree of freedom and no singular pose there is none then, within a
        turn and a half.
    """
    rng = np.random.default_rng(0)
    basis = null_space(robot.constraint_jacobian(q_start), 1e-9)
    places = [q_start]
    if basis.shape[1] == 1:
        found, places = _along_the_curve(robot, q_start, basis[:, 0], target, wanted)
        if found is not None or not places:
            return found
    for _ in range(_WALKS):
        q = places[int(rng.integers(len(places)))]
        ways = _ways(robot, q)
        walked = _walk(robot, q, ways @ rng.standard_normal(ways.shape[1]), int(rng.integers(_FEWEST, _MOST)))
        reached = follow(robot, walked[-1], target, wanted)
        if _left(robot, reached, target, wanted) <= _ARRIVED:
            return reached
        places = places if basis.shape[1] == 1 else [*places, walked[-1]]
    return None


def _along_the_curve(
    robot: Robot, q_start: Array, ahead: Array, target: Array, wanted: BoolArray
) -> tuple[Array | None, list[Array]]:
    """Where one degree of freedom reaches the target, or None; and the places where other curves begin."""
    size = _left(robot, q_start, target, wanted)
    strides = int((size + 2.0 * np.pi * _TURNS) / _STRIDE)
    places: list[Array] = []
    for direction in (ahead, -ahead):
        way = _walk(robot, q_start, direction, strides)
        left = np.array([_left(robot, q, target, wanted) for q in way])
        lowest = np.r_[True, left[1:] <= left[:-1]] & np.r_[left[:-1] <= left[1:], True]
        for node in np.flatnonzero(lowest & (left < _NEAR)):
            reached = follow(robot, way[node], target, wanted)
            if _left(robot, reached, target, wanted) <= _ARRIVED:
                return reached, places
        places += [q for q in way if _ways(robot, q).shape[1] > 1]
        if len(way) <= strides and _left(robot, way[-1], q_start, np.ones_like(wanted)) < _STRIDE:
            break  # once round
    return None, places


def _walk(robot: Robot, q: Array, ahead: Array, strides: int) -> list[Array]:
    """Configurations straight on along the constraints, from q until it gets stuck or comes back."""
    way, everything = [q], np.ones(robot.nv, dtype=np.bool_)
    for _ in range(strides):
        moved = _stride(robot, way[-1], ahead)
        if moved is None:
            break
        ahead = robot.difference(way[-1], moved)
        way.append(moved)
        if len(way) > _FEWEST and _left(robot, moved, q, everything) < 0.6 * _STRIDE:
            break
    return way


def _stride(robot: Robot, q: Array, ahead: Array) -> Array | None:
    """A step along the constraints in a direction that is nearly along them, or a shorter one."""
    ways = _ways(robot, q)
    along = ways @ (ways.T @ ahead)
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


def _ways(robot: Robot, q: Array) -> Array:
    """Directions along the constraints; near a singular pose, those of its branches, too."""
    return null_space(robot.constraint_jacobian(q), _LOOSE)


def _left(robot: Robot, q: Array, target: Array, wanted: BoolArray) -> float:
    return float(np.abs(robot.difference(q, target)[wanted]).max(initial=0.0))
