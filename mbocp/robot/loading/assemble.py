"""From the description of a robot to a `Robot`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._warn import warn_caller
from mbocp.exceptions import DimensionMismatch, InvalidValue, UnsupportedRobot
from mbocp.robot import joints
from mbocp.robot.loading.actuation import ActuationReader
from mbocp.robot.loading.checks import check_drives, check_mechanics
from mbocp.robot.loading.description import Description
from mbocp.robot.loading.elements import (
    connectors_of,
    constraints_of,
    forces_of,
    spheres_of,
    trace_frames,
)
from mbocp.robot.loading.initial_pose import close_loops
from mbocp.robot.loading.joint_frames import with_joint_frames
from mbocp.robot.loading.limits import limits_of
from mbocp.robot.loading.locking import by_joint, lock_joints, pose_by_joint
from mbocp.robot.loading.motors import with_motors
from mbocp.robot.loading.resistances import joint_resistances
from mbocp.robot.loading.table_reader import TableReader
from mbocp.robot.loops.undriven import Held, joints_to_hold
from mbocp.robot.robot import Robot
from mbocp.robot.warnings import HeldJointsWarning
from mbocp.symbolic import placements_of_followers


def assemble_robot(found: Description, actuated: Sequence[str] | None, spec: Mapping[str, Any]) -> Robot:
    """Lock joints, resolve the names of the tables, close loops, attach payloads, and check what came out.

    Parameters
    ----------
    found : Description
    actuated : sequence of str, optional
        As of `load_robot`; None: what the table says.
    spec : mapping
        What `robot_from_spec` needs to load the robot again.
    """
    joints.check_joints(found.model, found.name)
    if found.model.nv == 0:
        raise UnsupportedRobot(
            f"robot {found.name!r}: has no joint that moves; if it flies or walks, its root link floats: "
            "free_flyer = true, or --free-flyer"
        )
    model, visuals, q0, decided = lock_joints(
        found.model, found.visuals, found.pose, found.table.lock, found.name, found.named_locks
    )
    _set_gravity(model, found.table.gravity, found.name)
    gone = tuple(set(found.model.names) - set(model.names))
    tied = tuple(follower for follower in found.followers if follower.name not in gone)
    known = model.nframes
    model, table = with_joint_frames(model, found.table, found.name, found.file)
    decided = (*decided, *placements_of_followers(model, range(known, model.nframes), decided))
    model, q0, elastic = with_motors(model, q0, table.elastic, gone, found.name)
    names = TableReader(model, gone, found.name, found.file, q0)
    actuation, efforts = ActuationReader(names, table).actuation(actuated)
    constraints, forces = constraints_of(names, table), forces_of(names, table)
    robot = Robot(
        name=found.name,
        model=model,
        visual_model=visuals,
        actuation=actuation,
        constraints=constraints,
        forces=forces,
        q0=q0,
        limits=limits_of(model, tied, found.name, efforts),
        source=found.source,
        trace_frames=trace_frames(names, table),
        connectors=connectors_of(names, table, constraints, forces),
        spec=spec,
        description=table.description,
        rotations=table.rotations or "quaternion",
        resistances=tuple(
            resistance
            for losses in found.losses
            for resistance in joint_resistances(model, tied, losses, found.name)
        ),
        elastic=elastic,
        parts=found.parts,
        shapes=found.shapes,
        link_inertias=found.link_inertias,
        given_spheres=spheres_of(names, table),
        decided_by_locks=decided,
    )
    # Before payloads: the pose does not depend on what the robot carries.
    robot = close_loops(robot, [name for name in found.posed_joints if name in robot.joint_names])
    held = joints_to_hold(robot) if table.undriven == "hold" else Held()
    if held.joints:
        return assemble_robot(_with_held(found, robot, held), actuated, spec)
    robot = robot.with_payload(*found.carried) if found.carried else robot
    robot = replace(robot, q0=robot.balanced(robot.q0)) if elastic else robot
    check_drives(robot)
    check_mechanics(robot)
    return robot


def _with_held(found: Description, robot: Robot, held: Held) -> Description:
    """The description of a robot with joints locked where its loops are closed, and its pose there."""
    at = {name: robot.q0[robot.configuration_indices(name)].tolist() for name in robot.joint_names}
    values = ", ".join(f"{name!r} at {at[name][0]:.4g}" for name in held.joints)
    words = (
        f"robot {robot.name!r}: no motor drives what turns with {values}: held there, which adds at most "
        f'{100 * held.change:.2g} % to the inertia that motors feel (undriven "free" in '
        f"{found.file.name} lets it turn)"
    )
    warn_caller(HeldJointsWarning(words, held.joints))
    posed = pose_by_joint(found.model, found.pose, {n: q for n, q in at.items() if q}, found.name)
    locks = by_joint(found.table.lock) | {name: at[name] for name in held.joints}
    table = found.table.model_copy(update={"lock": locks, "initial": None, "undriven": "free"})
    return replace(found, q0=posed, table=table)


def _set_gravity(model: pin.Model, gravity: Sequence[float] | None, robot: str) -> None:
    if gravity is None:
        return
    vector = np.array(gravity, dtype=float)
    if vector.shape != (3,):
        raise DimensionMismatch(f"robot {robot!r}: gravity", vector.shape, (3,))
    if not np.isfinite(vector).all():
        raise InvalidValue(f"robot {robot!r}: gravity", vector.tolist(), "three finite numbers [m/s^2]")
    model.gravity.linear = vector
