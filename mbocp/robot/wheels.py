"""Wheels: joints whose angle nothing depends on, as balanced flywheels on a satellite.

A step that turns one far is a motion still, and Newton's method may change its angle by many turns at once.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray
from mbocp.robot import joints
from mbocp.robot.large import make_working_data

WHEEL_RANGE = 8.0 * math.pi  # [rad] arms turn less, and it matters to their tools where to
_BALANCED = 1e-9  # of the moment of inertia


def find_wheels(model: pin.Model, lower: Array, upper: Array) -> BoolArray:
    """Which components of v turn wheels, shape (nv,).

    These are revolute joints of a wide range, and continuous ones, that carry no joint, and whose mass is
    spread evenly about their axis: then neither inertia nor gravity depends on the angle.

    Parameters
    ----------
    model : pin.Model
    lower, upper : ndarray, shape (nq,)
        Limits of position [rad, m].
    """
    found = np.zeros(model.nv, dtype=np.bool_)
    for joint in range(1, model.njoints):
        kind = joints.joint_kind(model, joint).word
        if kind not in ("revolute", "continuous") or len(model.children[joint]):
            continue
        q = joints.configuration_slice(model, joint)
        if kind == "continuous" or (upper[q] - lower[q] >= WHEEL_RANGE).all():
            found[joints.velocity_slice(model, joint)] = _is_balanced(model, joint)
    return found


def _is_balanced(model: pin.Model, joint: int) -> bool:
    """Whether a turn about the joint's axis changes nothing of its body."""
    data, body = make_working_data(model), model.inertias[joint]
    jacobian = pin.computeJointJacobian(model, data, pin.neutral(model), joint)  # in the joint's axes
    axis = jacobian.reshape(6, model.nv)[3:, joints.velocity_slice(model, joint).start]
    turn = pin.SE3(pin.AngleAxis(1.0, axis).toRotationMatrix(), np.zeros(3))
    change = np.abs(turn.act(body).matrix() - body.matrix()).max()
    return bool(change <= _BALANCED * np.abs(body.matrix()).max())
