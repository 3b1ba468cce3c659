"""Models with other joints and masses than files give: motors of elastic joints, ball joints, no dynamics.

Some formats have no ball joints, so floating joints that robot.toml names are made into them. Motors of
elastic joints are joints of their own, beside the tree of links.

Many URDFs have no inertias. Without dynamics joints follow their controls, which are their accelerations.
Such a robot moves within limits of positions, speeds, accelerations and jerks all the same: its links have no
mass, and each joint a rotor of 1 kg m^2 (1 kg where it slides), so that M = 1 and a = u. Costs of effort are
those of accelerations. In closed loops only joints with motors have one: no force then acts between links.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray
from mbocp._measured import plain_number
from mbocp.exceptions import RobotError, UnsupportedRobot
from mbocp.robot import joints
from mbocp.robot.loading.description import ROOT_JOINT, Description
from mbocp.robot.loading.joint_numbers import Losses
from mbocp.robot.loading.robot_tables import ElasticTable, motor_of
from mbocp.robot.resistance import ElasticJoint
from mbocp.robot.robot import Robot
from mbocp.robot.rotors import unit_rotors

_ROTORS = {"revolute": pin.JointModelRZ, "prismatic": pin.JointModelPZ}
_OF_MOTORS = ("upperEffortLimit", "lowerEffortLimit", "upperVelocityLimit", "lowerVelocityLimit")
_POSITIONS = 3  # a floating joint's coordinates begin with these, in q and in v


def without_dynamics(found: Description) -> Description:
    """Return the robot with rotors in place of masses, damping, friction and limits of torques.

    Raises
    ------
    UnsupportedRobot
        If a joint has several velocities.
    """
    model = found.model.copy()
    several = [model.names[j] for j in range(1, model.njoints) if model.joints[j].nv > 1]
    if several:
        words = f"joint {several[0]!r} has several velocities, and no motor for each; fix it, or lock it"
        raise UnsupportedRobot(f"robot {found.name!r}: dynamics = false: {words}")
    for place in range(model.njoints):
        model.inertias[place] = pin.Inertia.Zero()
    model.armature = np.ones(model.nv)
    for losses in ("damping", "friction", "lowerEffortLimit", "upperEffortLimit", "rotorInertia"):
        setattr(model, losses, np.zeros(model.nv))
    return replace(found, model=model, losses=(Losses(damping=False, friction="none"),))


def with_rotors_at_motors(robot: Robot) -> Robot:
    """Return the robot with no rotor in joints without dynamics that closed loops move, and no motor."""
    in_loops = np.any(robot.constraint_jacobian(robot.q0) != 0.0, axis=0)
    follows = unit_rotors(robot.model) & in_loops & ~np.any(robot.actuation.selection != 0.0, axis=1)
    if not follows.any():
        return robot
    model = robot.model.copy()
    model.armature = np.where(follows, 0.0, model.armature)
    return replace(robot, model=model)


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
        _refuse_unfit_motor(model, joint, where, rotors)
        found.append(_add_motor(model, joint, row))
        q = np.append(q, q[found[-1].at_q[0]])
    return model, q, tuple(found)


def _refuse_unfit_motor(model: pin.Model, joint: int, where: str, rotors: BoolArray) -> None:
    kind, name = joints.joint_kind(model, joint).word, model.names[joint]
    if joint in model.mimicking_joints:
        raise UnsupportedRobot(f"{where}: {name!r} mimics another joint; name its leader")
    if kind not in _ROTORS:
        raise UnsupportedRobot(f"{where}: {name!r} is {kind}, expected a revolute or prismatic joint")
    if rotors[joints.velocity_slice(model, joint)].any():
        raise UnsupportedRobot(f"{where}: a spring acts on masses, and {name!r} moves none")
    if model.existFrame(motor_of(name)):
        raise UnsupportedRobot(
            f"{where}: a frame is called {motor_of(name)!r} already; rename it in its file"
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


def make_spherical(model: pin.Model, names: Sequence[str], robot: str) -> pin.Model:
    """Return the model with some floating joints turned into ball joints at the joint's origin.

    Parameters
    ----------
    model : pin.Model
        As the file says. It stays as it is.
    names : sequence of str
        Floating joints.
    robot : str
        Name for messages.

    Raises
    ------
    UnknownJoint
        For a joint that there is not.
    UnsupportedRobot
        For a joint that is not floating, and for models with mimic joints.
    """
    if not names:
        return model
    balls = {joints.joint_id(model, name, robot) for name in names}
    for ball in balls:
        _refuse_unfit_ball(model, ball, robot)
    out = pin.Model()
    out.name, out.gravity = model.name, model.gravity
    for joint in range(1, model.njoints):
        _copy_joint(model, out, joint, skip=_POSITIONS if joint in balls else 0)
    for frame in list(model.frames)[1:]:
        out.addFrame(frame, False)  # its inertia is in the joint's already
    return out


def _refuse_unfit_ball(model: pin.Model, joint: int, robot: str) -> None:
    kind, name = joints.joint_kind(model, joint), model.names[joint]
    where = f"robot {robot!r}: spherical: joint {name!r}"
    if name == ROOT_JOINT:
        raise UnsupportedRobot(f"{where} is the free-flyer of free_flyer = true: name a joint of the URDF")
    if kind.word != "floating":
        raise UnsupportedRobot(f'{where} is {kind.word}: give it type="floating" in the URDF')
    if len(model.mimicking_joints):
        follower = model.names[model.mimicking_joints[0]]
        raise UnsupportedRobot(
            f"{where} cannot be a ball joint beside mimic joint {follower!r}: load with mimic = false"
        )


def _copy_joint(model: pin.Model, out: pin.Model, joint: int, skip: int) -> None:
    kind = pin.JointModelSpherical() if skip else pin.JointModel(model.joints[joint])
    parent, placement = model.parents[joint], model.jointPlacements[joint]
    out.addJoint(parent, kind, placement, model.names[joint])
    out.appendBodyToJoint(joint, model.inertias[joint], pin.SE3.Identity())
    out.inertias[joint] = model.inertias[joint]  # to the last bit
    joints.copy_numbers(model, joint, out, joint, skip)
