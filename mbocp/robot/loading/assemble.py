"""From the description of a robot to a `Robot`, whose initial pose closes its loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._text import warn_caller
from mbocp.exceptions import DimensionMismatch, InvalidValue, LoopNotClosed, RobotFileError, UnsupportedRobot
from mbocp.robot import joints, kinematics
from mbocp.robot.kinematics import placement_from
from mbocp.robot.loading.actuation import ActuationReader, with_gears
from mbocp.robot.loading.description import Description
from mbocp.robot.loading.elements import connectors_of, constraints_of, forces_of, spheres_of, trace_frames
from mbocp.robot.loading.joint_numbers import joint_resistances, limits_of
from mbocp.robot.loading.locking import by_joint, lock_joints, pose_by_joint
from mbocp.robot.loading.mechanics_checks import check_accelerations, check_drives, check_mechanics
from mbocp.robot.loading.model_changes import with_motors, with_rotors_at_motors
from mbocp.robot.loading.robot_toml import RobotTable
from mbocp.robot.loading.table_types import TableReader
from mbocp.robot.loops.kinds.constraint import ConstraintKeys
from mbocp.robot.loops.projection import REDUNDANT_ROW_TOLERANCE, assemble, violations
from mbocp.robot.loops.redundancy import redundant_rows
from mbocp.robot.loops.undriven import Held, joints_to_hold
from mbocp.robot.poses.inverse_kinematics import close_anywhere
from mbocp.robot.robot import Robot
from mbocp.robot.warnings import HeldJointsWarning, InitialPoseWarning
from mbocp.symbolic.model_numbers import placements_of_followers


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
    robot = with_gears(robot, table.motor, gone) if table.motor else robot
    check_accelerations(robot)
    # Before payloads: the pose does not depend on what the robot carries.
    robot = close_loops(robot, [name for name in found.posed_joints if name in robot.joint_names])
    held = joints_to_hold(robot) if table.undriven == "hold" else Held()
    if held.joints:
        return assemble_robot(_hold_joints(found, robot, held), actuated, spec)
    robot = with_rotors_at_motors(robot)
    robot = robot.with_payload(*found.carried) if found.carried else robot
    robot = replace(robot, q0=robot.balanced(robot.q0)) if elastic else robot
    check_drives(robot)
    check_mechanics(robot)
    return robot


def _hold_joints(found: Description, robot: Robot, held: Held) -> Description:
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


def with_joint_frames(
    model: pin.Model, table: RobotTable, robot: str, file: Path
) -> tuple[pin.Model, RobotTable]:
    """Give each joint of a constraint with a placement a frame of its own, called NAME.a or NAME.b.

    Parameters
    ----------
    model : pin.Model
        After locking.
    table : RobotTable
    robot : str
        Name for messages.
    file : Path
        Where the table stands, for messages.

    Returns
    -------
    model : pin.Model
        A copy with the frames.
    table : RobotTable
        Whose constraints name these frames.

    Raises
    ------
    UnknownFrame
        If a frame does not exist.
    RobotFileError
        If the name of a frame is taken.
    """
    model, changed = pin.Model(model), list[ConstraintKeys]()
    for number, constraint in enumerate(table.constraints):
        frames = list[str]()
        for letter, (parent, position, orientation) in zip("ab", constraint.placements, strict=False):
            frames.append(parent)
            if position is None and orientation is None:
                continue
            frames[-1] = f"{constraint.name}.{letter}"
            if model.existFrame(frames[-1]):
                raise RobotFileError(
                    file,
                    f"a frame is called {frames[-1]!r} already: give the constraint another name",
                    f"constraint[{number}].name",
                )
            placement = placement_from(position or (0.0,) * 3, orientation or (0.0, 0.0, 0.0, 1.0))
            index = kinematics.frame_id(model, parent, robot)
            on = model.frames[index]
            at, kind = on.placement * placement, pin.FrameType.OP_FRAME
            model.addFrame(pin.Frame(frames[-1], on.parentJoint, index, at, kind), False)
        changed.append(constraint.model_copy(update={"frames": tuple(frames)} if frames else {}))
    return model, table.model_copy(update={"constraints": changed})


def close_loops(robot: Robot, given: Sequence[str]) -> Robot:
    """Return the robot with an initial pose that closes the loops, and without redundant rows.

    Parameters
    ----------
    robot : Robot
        With all rows of its constraints.
    given : sequence of str
        Joints whose initial position was written. They stay where they are if the loops can be closed so;
        else those of them that have a motor do, and the others say which assembly mode is meant.

    Raises
    ------
    LoopNotClosed
        If no pose near the initial one closes the loops.
    UnsupportedRobot
        If constraints say the same as others, or leave nothing that moves.

    Warns
    -----
    InitialPoseWarning
        If neither those with a motor could stay.
    """
    if not robot.constraints:
        return robot
    q0, held = _assemble(robot, given)
    posed = replace(robot, q0=q0)
    kept = replace(posed, redundant_rows=redundant_rows(posed))
    return replace(kept, q0=_close(kept, q0, held))


def _assemble(robot: Robot, given: Sequence[str]) -> tuple[Array, Sequence[str]]:
    """A pose that closes the loops up to few digits, and the joints that could be held."""
    moved = np.any(robot.actuation.selection != 0.0, axis=1)
    moved[list(robot.driven)] = True
    motors = [name for name in given if moved[robot.velocity_indices(name)].any()]
    for held in (given, motors) if motors else (given,):
        try:
            return assemble(robot, robot.q0, held, REDUNDANT_ROW_TOLERANCE), held
        except LoopNotClosed:
            # Robots that stand in a world for themselves are far from where their loops close.
            found = close_anywhere(robot, robot.q0, held) if robot.parts else None
            if found is not None:
                return found, held
            if not held:
                raise
    q0 = assemble(robot, robot.q0, (), REDUNDANT_ROW_TOLERANCE)
    bad = ", ".join(
        f"{name!r} by {value:.3g} {unit}" for name, value, unit in violations(robot, robot.q0)[:3]
    )
    warn_caller(
        f"robot {robot.name!r}: the initial pose violates {bad}; the nearest that closes the loops takes its "
        "place: give another in [initial] of its robot.toml, or fewer joints",
        InitialPoseWarning,
    )
    return q0, ()


def _close(robot: Robot, q0: Array, held: Sequence[str]) -> Array:
    """To round-off; joints whose position was written with a few digits move if they must."""
    try:
        return assemble(robot, q0, held)
    except LoopNotClosed:
        return assemble(robot, q0)
