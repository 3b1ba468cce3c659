"""Which rows of what is held are independent of each other, and of the loops of the robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp._linear import spanning_rows
from mbocp.mechanics.held_frames import HeldFrame, held_jacobians
from mbocp.mechanisms.consistent_states import CONSISTENCY_TOLERANCE, project_on_constraints
from mbocp.robot import Robot

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
    qs = _poses(robot, q)
    jacobians = held_jacobians(robot, held, qs)[:, wanted]
    loops = np.array([robot.constraint_jacobian(at)[own] for at in qs]).reshape(len(qs), -1, robot.nv)
    best = max((_independent(*pair) for pair in zip(loops, jacobians, strict=True)), key=len)
    found = np.zeros_like(wanted)
    found[np.flatnonzero(wanted)[best]] = True
    return found


def is_moved(robot: Robot, q: Array, frame: HeldFrame) -> bool:
    """Whether motions of the robot change what is held, at the configuration or around it.

    An arm that is stretched out up moves its tip in no height at first.
    """
    return bool(np.abs(held_jacobians(robot, (frame,), _poses(robot, q))).max() > CONSISTENCY_TOLERANCE)


def _poses(robot: Robot, q: Array) -> Array:
    """The configuration, and some around it; loops stay closed."""
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
    return spanning_rows(rest, _RANK_TOLERANCE)


def _unit(rows: Array) -> Array:
    lengths = np.linalg.norm(rows, axis=1)
    return rows / np.where(lengths > _RANK_TOLERANCE, lengths, np.inf)[:, None]
