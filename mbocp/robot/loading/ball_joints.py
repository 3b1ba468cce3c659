"""Ball joints: some formats have none, so floating joints that robot.toml names are made into them."""

from __future__ import annotations

from collections.abc import Sequence

import pinocchio as pin

from mbocp.exceptions import UnsupportedRobot
from mbocp.robot import joints
from mbocp.robot.loading.description import ROOT_JOINT

_POSITIONS = 3  # a floating joint's coordinates begin with these, in q and in v


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
        _refuse_unfit(model, ball, robot)
    out = pin.Model()
    out.name, out.gravity = model.name, model.gravity
    for joint in range(1, model.njoints):
        _copy_joint(model, out, joint, skip=_POSITIONS if joint in balls else 0)
    for frame in list(model.frames)[1:]:
        out.addFrame(frame, False)  # its inertia is in the joint's already
    return out


def _refuse_unfit(model: pin.Model, joint: int, robot: str) -> None:
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
