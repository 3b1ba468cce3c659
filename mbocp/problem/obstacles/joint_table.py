"""Joints of a robot in numbers, as the native room has them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot import joints
from mbocp.robot.large import make_working_data

_SCREW, _CIRCLE = 0, 1
_KINDS = {
    "revolute": _SCREW,
    "prismatic": _SCREW,
    "helical": _SCREW,
    "continuous": _CIRCLE,
    "planar": 2,
    "floating": 3,
    "spherical": 4,
    "translation": 5,
}
_MOVED = 0.5  # [rad, m] of the joint whose twist is looked at: exact, for it is constant


def joint_table(model: pin.Model) -> Array:
    """A row for each joint but the world: parent, kind, first number, placement at rest, twist of a unit.

    Returns
    -------
    ndarray, shape (njoints - 1, 21)
        The twist, linear before angular, is that of joints with one number, zero of others; joints that mimic
        another have the numbers of that one.
    """
    mimicked = dict(zip(model.mimicking_joints, model.mimicked_joints, strict=True))
    data = make_working_data(model)
    at_rest, moved = _placements(model, data, 0.0), _placements(model, data, _MOVED)
    rows = []
    for joint in range(1, model.njoints):
        owner = mimicked.get(joint, joint)
        kind = _KINDS[joints.joint_kind(model, owner).word]
        first = joints.configuration_slice(model, owner).start
        placement, twist = model.jointPlacements[joint], np.zeros(6)
        if kind in (_SCREW, _CIRCLE):
            placement = at_rest[joint]
            twist = _twist(placement.actInv(moved[joint]))
        rows.append([model.parents[joint], kind, first, *placement_numbers(placement), *twist])
    return np.array(rows, dtype=np.float64).reshape(-1, 21)


def placement_numbers(placement: pin.SE3) -> Array:
    """Axes by rows and origin, shape (12,)."""
    return np.concatenate([np.ravel(placement.rotation), placement.translation])


def _placements(model: pin.Model, data: pin.Data, amount: float) -> list[pin.SE3]:
    """Of each joint in its parent, where those with one number are moved by as much."""
    q = np.array(pin.neutral(model))
    for joint in range(1, model.njoints):
        kind = joints.joint_kind(model, joint)
        if kind.word in _KINDS and _KINDS[kind.word] == _SCREW:
            q[joints.configuration_slice(model, joint)] = amount
        elif kind.word == "continuous":
            q[joints.configuration_slice(model, joint)] = np.cos(amount), np.sin(amount)
    pin.forwardKinematics(model, data, q)
    return [pin.SE3(placement) for placement in data.liMi]


def _twist(moved: pin.SE3) -> Array:
    """Of a unit: linear and angular part, which are along each other or one of them is zero."""
    return np.concatenate([moved.translation, pin.log3(moved.rotation)]) / _MOVED
