"""Configurations along a sequence of poses: one branch of inverse kinematics from one end to the other."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot.mechanism import Mechanism
from mbocp.robot.poses.bounds import joint_bounds
from mbocp.robot.poses.rows import PoseRows
from mbocp.robot.poses.search import reach
from mbocp.robot.poses.target import FrameTarget

_TOLERANCE = 1e-9  # [m, rad]
_LEAP, _FACTOR = 0.5, 4.0  # [rad, m] beyond so many times the step of what is near: another branch


def along_poses(
    robot: Mechanism, poses: Sequence[Sequence[FrameTarget]], near: Array, limits: tuple[Array, Array]
) -> Array | None:
    """Configurations that reach one set of targets after the other.

    Parameters
    ----------
    robot : Mechanism
    poses : sequence of sequence of FrameTarget
        Targets of each configuration.
    near : ndarray, shape (n, nq)
        A continuous way, whose branch the configurations have.
    limits : tuple of ndarray, shapes (nq,)
        Lower and upper positions that they keep [rad, m].

    Returns
    -------
    qs : ndarray, shape (n, nq), or None
        None if one is out of reach from there, or they leap from one branch to another.
    """
    bounds = joint_bounds(robot.model, *limits, frozenset())
    held = np.zeros(robot.model.nv, dtype=np.bool_)
    found, aside = np.empty_like(near), np.zeros(robot.model.nv)
    for n, targets in enumerate(poses):
        first = bounds.clip(pin.integrate(robot.model, near[n], aside))
        q, has_arrived = reach(PoseRows(robot, targets), first, bounds, held, _TOLERANCE)
        if not has_arrived:
            return None
        found[n], aside = q, pin.difference(robot.model, near[n], q)
    return None if _leaps(robot.model, found, near) else found


def _leaps(model: pin.Model, qs: Array, near: Array) -> bool:
    steps, usual = (
        np.array([np.abs(pin.difference(model, a, b)).max() for a, b in pairwise(way)]) for way in (qs, near)
    )
    return bool((steps > _LEAP + _FACTOR * usual).any())
