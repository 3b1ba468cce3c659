"""How far the parts of a robot can get: which things can never meet."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot import joints

_TURNING = ("revolute", "continuous", "spherical")


def ancestors(model: pin.Model, joint: int) -> tuple[int, ...]:
    """Joints on the way from the world to a joint, which is the last of them; empty for the world."""
    found = []
    while joint > 0:
        found.append(joint)
        joint = int(model.parents[joint])
    return tuple(reversed(found))


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
    chain = ancestors(model, joint)
    if not chain:
        return np.array(point), 0.0
    lengths = [float(np.linalg.norm(model.jointPlacements[k].translation)) for k in chain[1:]]
    slides = [_travel(model, k, q_lower, q_upper) for k in chain]
    radius = float(np.linalg.norm(point)) + sum(lengths) + sum(slides)
    return np.array(model.jointPlacements[chain[0]].translation), radius


def _travel(model: pin.Model, joint: int, q_lower: Array, q_upper: Array) -> float:
    """How far a joint moves the origin of its frame [m]."""
    word = joints.joint_kind(model, joint).word
    if word in _TURNING:
        return 0.0
    if word != "prismatic" or joint in list(model.mimicking_joints):
        return float("inf")
    where = joints.configuration_slice(model, joint)
    return float(np.max(np.abs([q_lower[where], q_upper[where]])))
