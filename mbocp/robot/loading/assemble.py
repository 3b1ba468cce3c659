"""From a model with its visuals, pose and tables to a `Robot`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from mbocp.exceptions import DimensionMismatch, InvalidValue, UnknownFrame, UnsupportedRobot
from mbocp.robot import joints, kinematics
from mbocp.robot.collision.source import CollisionSphere
from mbocp.robot.loading.body import Body, initial_pose, posed_joints
from mbocp.robot.loading.checks import check_mechanics
from mbocp.robot.loading.drive_checks import check_drives
from mbocp.robot.loading.elements import Assembly
from mbocp.robot.loading.initial_pose import close_loops
from mbocp.robot.loading.joint_frames import with_joint_frames
from mbocp.robot.loading.locking import Lock, lock_joints
from mbocp.robot.loading.resistances import Losses, joint_resistances
from mbocp.robot.loading.schema import RobotTable
from mbocp.robot.payload import Payload
from mbocp.robot.resistance import FRICTION_SPEED
from mbocp.robot.robot import Robot
from mbocp.symbolic import placements_of_followers

# Losses of some joints, by name; None: of all.
LossesOf: TypeAlias = tuple[Losses, frozenset[str] | None]


def assemble_robot(
    body: Body,
    *,
    lock: Lock | None,
    named_locks: Sequence[str],
    gravity: Sequence[float] | None,
    actuated: Sequence[str] | None,
    rotations: str | None,
    losses: Sequence[LossesOf],
    carried: tuple[Payload, ...],
    spec: Mapping[str, Any],
) -> Robot:
    """Lock joints, resolve the names of the tables, close loops, attach payloads, and check what came out.

    Parameters
    ----------
    body : Body
    lock, gravity, actuated, rotations
        As of `load_robot`; None: what the table says.
    named_locks : sequence of str
        Joints that options lock: other values of theirs are other numbers of the same functions.
    losses : sequence of LossesOf
        Damping and friction that act.
    carried : tuple of Payload
    spec : mapping
        What `robot_from_spec` needs to load the robot again.
    """
    joints.check_joints(body.model, body.name)
    if body.model.nv == 0:
        raise UnsupportedRobot(
            f"robot {body.name!r}: has no joint that moves; if it flies or walks, its root link floats: "
            "free_flyer = true, or --free-flyer"
        )
    locks = body.table.lock if lock is None else lock
    named = {*body.named_locks, *named_locks}
    model, visuals, q0, decided = lock_joints(
        body.model, body.visuals, initial_pose(body), locks, body.name, named
    )
    _set_gravity(model, gravity if gravity is not None else body.table.gravity, body.name)
    gone = tuple(set(body.model.names) - set(model.names))
    tied = tuple(follower for follower in body.followers if follower.name not in gone)
    known = model.nframes
    model, table = with_joint_frames(model, body.table, body.name, body.file)
    decided = (*decided, *placements_of_followers(model, range(known, model.nframes), decided))
    parts = Assembly(model, gone, q0, table, body.name, body.file, tied)
    actuation, efforts = parts.actuation(actuated)
    constraints, forces = parts.constraints(), parts.forces()
    robot = Robot(
        name=body.name,
        model=model,
        visual_model=visuals,
        actuation=actuation,
        constraints=constraints,
        forces=forces,
        q0=q0,
        limits=parts.limits(efforts),
        source=body.urdf,
        trace_frames=parts.trace_frames(),
        connectors=parts.connectors(constraints, forces),
        spec=spec,
        description=body.table.description,
        rotations=rotations or body.table.rotations or "quaternion",
        resistances=tuple(
            resistance
            for acting, names in losses
            for resistance in joint_resistances(model, tied, acting, body.name, names)
        ),
        parts=body.parts,
        collision=body.collision,
        given_spheres=_given_spheres(model, body),
        decided_by_locks=decided,
    )
    # Before payloads: the pose does not depend on what the robot carries.
    robot = close_loops(robot, [name for name in posed_joints(body) if name in robot.joint_names])
    robot = robot.with_payload(*carried) if carried else robot
    check_drives(robot)
    check_mechanics(robot)
    return robot


def losses_of(table: RobotTable, damping: bool | None, friction: str | None, speed: float | None) -> Losses:
    """Losses: options take precedence over robot.toml, and robot.toml over defaults."""
    said = ((damping, table.damping, True), (speed, table.friction_speed, FRICTION_SPEED))
    acts, scale = (next(value for value in values if value is not None) for values in said)
    return Losses(bool(acts), table.friction if friction is None else friction, float(scale))


def _given_spheres(model: pin.Model, body: Body) -> tuple[CollisionSphere, ...]:
    """Spheres of the table, whose frames exist."""
    for number, row in enumerate(body.table.collision_spheres):
        try:
            kinematics.frame_id(model, row.frame, body.name)
        except UnknownFrame as error:
            error.args = (f"{body.file}: collision_sphere[{number}].frame: {error}",)
            raise
    return tuple(CollisionSphere(row.frame, row.center, row.radius) for row in body.table.collision_spheres)


def _set_gravity(model: pin.Model, gravity: Sequence[float] | None, robot: str) -> None:
    if gravity is None:
        return
    vector = np.array(gravity, dtype=float)
    if vector.shape != (3,):
        raise DimensionMismatch(f"robot {robot!r}: gravity", vector.shape, (3,))
    if not np.isfinite(vector).all():
        raise InvalidValue(f"robot {robot!r}: gravity", vector.tolist(), "three finite numbers [m/s^2]")
    model.gravity.linear = vector
