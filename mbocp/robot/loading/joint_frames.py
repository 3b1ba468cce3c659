"""Frames of constraints that do not stand at the origin of a frame that the robot has."""

from __future__ import annotations

from pathlib import Path

import pinocchio as pin

from mbocp.exceptions import RobotFileError
from mbocp.robot import kinematics
from mbocp.robot.loading.constraint_tables import ConstraintTable, CouplingTable
from mbocp.robot.loading.placement_table import placement_from
from mbocp.robot.loading.schema import RobotTable

__all__ = ["with_joint_frames"]

_ENDS = (("a", "position", "orientation"), ("b", "position_b", "orientation_b"))


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
    model, changed = pin.Model(model), list[ConstraintTable]()
    for number, constraint in enumerate(table.constraints):
        if isinstance(constraint, CouplingTable):
            changed.append(constraint)
            continue
        name, frames = constraint.name or f"{constraint.type}_{number}", list(constraint.frames)
        for end, (letter, *keys) in enumerate(_ENDS):
            position, orientation = (getattr(constraint, key) for key in keys)
            if position is None and orientation is None:
                continue
            own = f"{name}.{letter}"
            if own in {frame.name for frame in model.frames}:
                raise RobotFileError(
                    file,
                    f"a frame is called {own!r} already: give the constraint another name",
                    f"constraint[{number}].name",
                )
            index = kinematics.frame_id(model, frames[end], robot)
            placement = placement_from(position or (0.0,) * 3, orientation or (0.0, 0.0, 0.0, 1.0))
            parent = model.frames[index]
            frame = pin.Frame(
                own, parent.parentJoint, index, parent.placement * placement, pin.FrameType.OP_FRAME
            )
            model.addFrame(frame, False)
            frames[end] = own
        changed.append(constraint.model_copy(update={"name": name, "frames": tuple(frames)}))
    return model, table.model_copy(update={"constraints": changed})
