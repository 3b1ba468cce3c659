"""Motors of elastic joints: joints of their own, beside the tree of links."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray
from mbocp._measured import plain_number
from mbocp.exceptions import RobotError, UnsupportedRobot
from mbocp.robot import joints
from mbocp.robot.elastic import ElasticJoint
from mbocp.robot.loading.elastic_table import ElasticTable, motor_of
from mbocp.robot.loading.kinematic import unit_rotors

_ROTORS = {"revolute": pin.JointModelRZ, "prismatic": pin.JointModelPZ}
_OF_MOTORS = ("upperEffortLimit", "lowerEffortLimit", "upperVelocityLimit", "lowerVelocityLimit")


def with_motors(
    model: pin.Model, q0: Array, rows: Sequence[ElasticTable], gone: Sequence[str], robot: str
) -> tuple[pin.Model, Array, tuple[ElasticJoint, ...]]:
    """Return the model and pose with a joint for each motor, and what joins them.

    The motors come last, and have the limits of effort and speed that the file gives the joints.

    Parameters
    ----------
    model : pin.Model
        After locking.
    q0 : ndarray, shape (nq,)
    rows : sequence of ElasticTable
    gone : sequence of str
        Joints that were locked; they have no motors.
    robot : str
        Name for messages.

    Raises
    ------
    RobotError
        For a joint that is named twice or does not exist, and one that cannot be elastic.
    """
    model, q, found = pin.Model(model), q0, list[ElasticJoint]()
    rotors = unit_rotors(model)
    for number, row in enumerate(rows):
        if row.joint in gone:
            continue
        where = f"robot {robot!r}: elastic[{number}].joint"
        if row.joint in {one.name for one in found}:
            raise RobotError(f"{where}: {row.joint!r} is named twice")
        joint = joints.joint_id(model, row.joint, robot)
        _refuse_unfit(model, joint, where, rotors)
        found.append(_add_motor(model, joint, row))
        q = np.append(q, q[found[-1].at_q[0]])
    return model, q, tuple(found)


def _refuse_unfit(model: pin.Model, joint: int, where: str, rotors: BoolArray) -> None:
    kind, name = joints.joint_kind(model, joint).word, model.names[joint]
    if joint in model.mimicking_joints:
        raise UnsupportedRobot(f"{where}: {name!r} mimics another joint; name its leader")
    if kind not in _ROTORS:
        raise UnsupportedRobot(f"{where}: {name!r} is {kind}, expected a revolute or prismatic joint")
    if rotors[joints.velocity_slice(model, joint)].any():
        raise UnsupportedRobot(f"{where}: a spring acts on masses, and {name!r} moves none")
    if model.existFrame(motor_of(name)):
        raise UnsupportedRobot(
            f"{where}: a frame is called {motor_of(name)!r} already; rename it in the URDF"
        )


def _add_motor(model: pin.Model, joint: int, row: ElasticTable) -> ElasticJoint:
    kind = _ROTORS[joints.joint_kind(model, joint).word]()
    motor = model.addJoint(0, kind, pin.SE3.Identity(), motor_of(row.joint))
    model.addJointFrame(motor)
    unit = "m" if joints.joint_kind(model, joint).word == "prismatic" else "rad"
    row = row.model_copy(
        update={
            key: plain_number(getattr(row, key), unit, f"elastic: {row.joint!r}: {key}")
            for key in ("stiffness", "damping", "motor_inertia")
        }
    )
    link, rotor = (joints.velocity_slice(model, one).start for one in (joint, motor))
    for key in ("armature", "rotorInertia"):
        numbers = getattr(model, key)  # a rotor that a file gives the joint is this one
        numbers[rotor], numbers[link] = row.motor_inertia, 0.0
    model.rotorGearRatio[rotor] = 1.0
    for key in _OF_MOTORS:
        limits = getattr(model, key)
        limits[rotor], limits[link] = limits[link], 0.0
    at_q = tuple(joints.configuration_slice(model, one).start for one in (joint, motor))
    return ElasticJoint(row.joint, motor_of(row.joint), at_q, (link, rotor), row.stiffness, row.damping)
