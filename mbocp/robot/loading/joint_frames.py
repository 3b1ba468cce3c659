"""Frames of constraints that do not stand at the origin of a frame that the robot has."""

from __future__ import annotations

from pathlib import Path

import pinocchio as pin

from mbocp.exceptions import RobotFileError
from mbocp.robot import kinematics
from mbocp.robot.loading.schema import RobotTable
from mbocp.robot.loading.table_types import placement_from
from mbocp.robot.loops.constraints import ConstraintKeys


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
        name, frames = constraint.name or f"{constraint.type}_{number}", list[str]()
        for letter, (parent_name, position, orientation) in zip("ab", constraint.placements, strict=False):
            frames.append(parent_name)
            if position is None and orientation is None:
                continue
            own = f"{name}.{letter}"
            if own in {frame.name for frame in model.frames}:
                raise RobotFileError(
                    file,
                    f"a frame is called {own!r} already: give the constraint another name",
                    f"constraint[{number}].name",
                )
            index = kinematics.frame_id(model, parent_name, robot)
            placement = placement_from(position or (0.0,) * 3, orientation or (0.0, 0.0, 0.0, 1.0))
            parent = model.frames[index]
            frame = pin.Frame(
                own, parent.parentJoint, index, parent.placement * placement, pin.FrameType.OP_FRAME
            )
            model.addFrame(frame, False)
            frames[-1] = own
        joined = {"name": name, "frames": tuple(frames)} if frames else {}
        changed.append(constraint.model_copy(update=joined))
    return model, table.model_copy(update={"constraints": changed})
