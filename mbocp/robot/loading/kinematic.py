"""Robots without dynamics: joints follow their controls, which are their accelerations.

Many URDFs have no inertias. Such a robot moves within limits of positions, speeds, accelerations and jerks
all the same: its links have no mass, and each joint a rotor of 1 kg m^2 (1 kg where it slides), so that M = 1
and a = u. Costs of effort are those of accelerations.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from mbocp._arrays import BoolArray
from mbocp.exceptions import UnsupportedRobot
from mbocp.robot import joints
from mbocp.robot.loading.description import Description
from mbocp.robot.loading.resistances import Losses


def without_dynamics(found: Description) -> Description:
    """Return the robot with rotors in place of masses, damping, friction and limits of torques.

    Raises
    ------
    UnsupportedRobot
        If a joint has several velocities, or a force acts, or something is carried: they would move masses
        that are none.
    """
    model = found.model.copy()
    several = [model.names[j] for j in range(1, model.njoints) if model.joints[j].nv > 1]
    if several:
        _refuse(
            found, f"joint {several[0]!r} has several velocities, and no motor for each; fix it, or lock it"
        )
    for key, rows in (("spring", found.table.springs), ("spring_damper", found.table.spring_dampers)):
        if rows:
            _refuse(found, f"a {key} acts on masses, and there are none; leave one of the two out")
    if any(payload.mass for payload in found.carried):
        _refuse(found, "a payload has a mass, and links have none; leave one of the two out")
    for place in range(model.njoints):
        model.inertias[place] = pin.Inertia.Zero()
    model.armature = np.ones(model.nv)
    for losses in ("damping", "friction", "effortLimit", "rotorInertia"):
        setattr(model, losses, np.zeros(model.nv))
    return replace(found, model=model, losses=(Losses(damping=False, friction="none"),))


def unit_rotors(model: pin.Model) -> BoolArray:
    """Velocities that move such a rotor and nothing else, shape (nv,): their controls are accelerations."""
    found = np.zeros(model.nv, dtype=np.bool_)
    for joint in range(1, model.njoints):
        moved = [model.inertias[j] for j in model.subtrees[joint]]
        where = joints.velocity_slice(model, joint)
        if not any(one.mass or np.any(one.inertia) for one in moved):
            is_unit = np.asarray(model.armature)[where] == 1.0
            found[where] = is_unit & (np.asarray(model.rotorInertia)[where] == 0.0)  # none of a real motor
    return found


def _refuse(found: Description, why: str) -> None:
    raise UnsupportedRobot(f"robot {found.name!r}: dynamics = false: {why}")
