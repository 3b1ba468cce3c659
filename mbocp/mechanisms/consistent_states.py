"""States that fit the holonomic constraints, the search for them, and rows that depend on others.

The straight way is `mbocp.robot.loops.projection.follow`. Where it gets stuck, there may be a way round: a
mechanism with one degree of freedom is led along its curve in both directions, others on random walks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbocp._arrays import Array, BoolArray, null_space, select_spanning_rows
from mbocp._tolerances import ARRIVAL_TOLERANCE, RANK_TOLERANCE
from mbocp.exceptions import InconsistentStart
from mbocp.mechanics.held_frames import HeldFrame, compute_held_jacobians
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


# A start with nine digits is accepted, a measurable violation is not. The first step of the mechanics removes
# the rest.
CONSISTENCY_TOLERANCE = 1e-8  # [m, rad, m^2 for a rod, and their rates]

_MAX_PROJECTION_STEPS = 30  # Gauss-Newton is quadratic here: six are typical


def check_position(robot: Robot, q: Array, key: str) -> None:
    """Refuse a configuration that violates a holonomic constraint."""
    bad = violations(robot, q, CONSISTENCY_TOLERANCE) if robot.nc else []
    if bad:
        table = key.partition(".")[0]
        advice = f"correct q so that the constraint holds, or say {table}.assemble = true for the nearest one"
        raise _violates(robot, *bad[0], key, advice)


def check_velocity(robot: Robot, q: Array, v: Array, key: str) -> None:
    """Refuse a velocity that leaves the constraint manifold."""
    if not robot.nc:
        return
    rate = robot.constraint_jacobian(q) @ v
    worst = int(np.abs(rate).argmax())
    if np.abs(rate[worst]) > CONSISTENCY_TOLERANCE:
        label = robot.constraint_labels[worst]
        advice = (
            "give a velocity or momentum that is tangential to the constraint, or say "
            f"{key}.assemble = true for the nearest one"
        )
        raise _violates(robot, label.name, float(rate[worst]), f"{label.unit}/s", key, advice)


def project_on_constraints(robot: Robot, q: Array, free: NDArray[np.intp]) -> Array:
    """Gauss-Newton on Phi(q) = 0 in the directions `free`."""
    for _ in range(_MAX_PROJECTION_STEPS):
        residual = robot.constraint_residual(q)
        if np.abs(residual).max() < 1e-14:  # round-off of some metres
            break
        step = np.zeros(robot.nv)
        dPhi_dq = robot.constraint_jacobian(q)[:, free]
        step[free] = -np.linalg.lstsq(dPhi_dq, residual, rcond=RANK_TOLERANCE)[0]
        q = robot.integrate(q, step)
    return q


def tangent_space(robot: Robot, q: Array) -> Array:
    """Orthonormal basis of the velocities that the constraints allow at q, shape (nv, nv - rank).

    From an SVD, for any constraint: the closed form (46) of the paper is singular where q_x = q_z = 0.
    """
    if not robot.nc:
        return np.eye(robot.nv)
    return null_space(robot.constraint_jacobian(q), RANK_TOLERANCE)


def span_allowed_velocities(robot: Robot, q: Array) -> Array:
    """Directions that span the velocities which constraints and drives allow at q, shape (nv, any)."""
    if not robot.drives:
        return tangent_space(robot, q)
    driven: Array = np.hstack([robot.speed_map(q), robot.control_velocity_map(q)])
    if robot.nc:
        driven = driven @ null_space(robot.constraint_jacobian(q) @ driven, RANK_TOLERANCE)
    return driven


def _violates(robot: Robot, row: str, value: float, unit: str, key: str, advice: str) -> InconsistentStart:
    return InconsistentStart(
        f"{key}: violates constraint {row!r} of robot {robot.name!r} by {value:.3g} {unit} (allowed: "
        f"{CONSISTENCY_TOLERANCE:g}); {advice}"
    )


_NUM_POSES = 4  # around the start: what depends there by chance does not elsewhere
_SPREAD = 0.2  # [rad, m]
_RANK_TOLERANCE = 1e-6  # of a row's length


def find_independent_rows(
    robot: Robot, q: Array, held: Sequence[HeldFrame], own: BoolArray, wanted: BoolArray
) -> BoolArray:
    """Rows among the wanted ones that the others do not imply, shape (rows,).

    Parameters
    ----------
    q : ndarray, shape (nq,)
        A configuration of the motion; others are drawn around it.
    held : sequence of HeldFrame
    own : ndarray of bool, shape (nc,)
        The robot's own rows that act: they are kept.
    wanted : ndarray of bool, shape (rows,)
        Rows of the held frames that are to act.
    """
    if not wanted.any():
        return wanted
    qs = poses_around(robot, q)
    jacobians = compute_held_jacobians(robot, held, qs)[:, wanted]
    loops = np.array([robot.constraint_jacobian(at)[own] for at in qs]).reshape(len(qs), -1, robot.nv)
    best = max((_independent(*pair) for pair in zip(loops, jacobians, strict=True)), key=len)
    found = np.zeros_like(wanted)
    found[np.flatnonzero(wanted)[best]] = True
    return found


def poses_around(robot: Robot, q: Array) -> Array:
    """Return the configuration, and some around it in which loops stay closed, shape (n, nq).

    An arm that is stretched out up moves its tip in no height at first.
    """
    rng, every = np.random.default_rng(0), np.arange(robot.nv)
    away = [robot.integrate(q, rng.normal(scale=_SPREAD, size=robot.nv)) for _ in range(_NUM_POSES)]
    if robot.nc:
        away = [project_on_constraints(robot, at, every) for at in away]
    return np.array([q, *away])


def _independent(given: Array, jacobian: Array) -> list[int]:
    """Rows that span what the given ones do not, by Gram-Schmidt with pivots."""
    rest = _unit(jacobian)
    if given.size:
        _, values, right = np.linalg.svd(_unit(given), full_matrices=False)
        right = right[values > _RANK_TOLERANCE]
        rest = rest - rest @ right.T @ right
    return select_spanning_rows(rest, _RANK_TOLERANCE)


def _unit(rows: Array) -> Array:
    lengths = np.linalg.norm(rows, axis=1)
    return rows / np.where(lengths > _RANK_TOLERANCE, lengths, np.inf)[:, None]
