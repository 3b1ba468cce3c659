"""Frames of constraints that do not stand at the origin of a frame that the robot has."""

from __future__ import annotations

from pathlib import Path

import pinocchio as pin

from mbocp.exceptions import RobotFileError
from mbocp.robot import kinematics
from mbocp.robot.kinematics import placement_from
from mbocp.robot.loading.schema import RobotTable
from mbocp.robot.loops.kinds.base import ConstraintKeys


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
            _add_frame(model, frames[-1], kinematics.frame_id(model, parent, robot), placement)
        changed.append(constraint.model_copy(update={"frames": tuple(frames)} if frames else {}))
    return model, table.model_copy(update={"constraints": changed})


def _add_frame(model: pin.Model, name: str, parent: int, placement: pin.SE3) -> None:
    """Add a frame at a place in another one."""
    on = model.frames[parent]
    frame = pin.Frame(name, on.parentJoint, parent, on.placement * placement, pin.FrameType.OP_FRAME)
    model.addFrame(frame, False)
