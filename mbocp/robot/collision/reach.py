"""How far the parts of a robot can get: which things can never meet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot import joints

_TURNING = ("revolute", "continuous", "spherical")


def reach(model: pin.Model, joint: int, point: Array, q_lower: Array, q_upper: Array) -> tuple[Array, float]:
    """Centre, shape (3,), and radius [m] of a ball that a point of a joint's body never leaves.

    Parameters
    ----------
    model : pin.Model
    joint : int
    point : ndarray, shape (3,)
        In the frame of the joint [m].
    q_lower, q_upper : ndarray, shape (nq,)
        Limits that are kept: how far prismatic joints slide. Infinite where there are none.

    Returns
    -------
    tuple of (ndarray, float)
        The radius is infinite where a joint floats, or slides without limits.
    """
    _, *chain = model.supports[joint]
    if not chain:
        return np.array(point), 0.0
    below = length_of(model, chain[1:], q_lower, q_upper)
    radius = float(np.linalg.norm(point)) + below + _travel(model, chain[0], q_lower, q_upper)
    return np.array(model.jointPlacements[chain[0]].translation), radius


def length_of(model: pin.Model, chain: Sequence[int], q_lower: Array, q_upper: Array) -> float:
    """How far the last of some joints can be from the body that carries the first, see `reach` [m]."""
    lengths = (float(np.linalg.norm(model.jointPlacements[k].translation)) for k in chain)
    return sum(lengths) + sum(_travel(model, k, q_lower, q_upper) for k in chain)


def _travel(model: pin.Model, joint: int, q_lower: Array, q_upper: Array) -> float:
    """How far a joint moves the origin of its frame [m]."""
    word = joints.joint_kind(model, joint).word
    if word in _TURNING:
        return 0.0
    if word != "prismatic" or joint in list(model.mimicking_joints):
        return float("inf")
    where = joints.configuration_slice(model, joint)
    return float(np.max(np.abs([q_lower[where], q_upper[where]])))
