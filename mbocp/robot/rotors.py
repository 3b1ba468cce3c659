"""Joints without dynamics: each turns a rotor of its own and no mass, so that controls are accelerations.

In closed loops only joints with motors have rotors: the others follow them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbocp._arrays import BoolArray
from mbocp.robot import joints

_ROTORS = (0.0, 1.0)  # of joints that follow others, and of those with motors [kg m^2, kg]


def unit_rotors(model: pin.Model) -> BoolArray:
    """Velocities that move rotors of 1 kg m^2 (or 1 kg) and nothing else, shape (nv,)."""
    armature, real = np.asarray(model.armature), np.asarray(model.rotorInertia)
    found = np.zeros(model.nv, dtype=np.bool_)
    for joint in range(1, model.njoints):
        moved = [model.inertias[j] for j in model.subtrees[joint]]
        where = joints.velocity_slice(model, joint)
        if not any(one.mass or np.any(one.inertia) for one in moved):
            found[where] = np.isin(armature[where], _ROTORS) & (real[where] == 0.0)  # none of a real motor
    return found & bool(np.any(armature[found] == 1.0))


def kinds_of_ends(model: pin.Model, frame_ids: Sequence[int], joint_ids: Sequence[int] = ()) -> set[bool]:
    """Whether joints without dynamics move frames and joints, of those that anything moves."""
    rotors = unit_rotors(model)
    if not rotors.any():
        return set()
    ends = [model.frames[frame].parentJoint for frame in frame_ids]
    chains = [[int(j) for j in model.supports[end] if j] for end in (*ends, *joint_ids)]
    return {any(rotors[joints.velocity_slice(model, j)].any() for j in chain) for chain in chains if chain}
