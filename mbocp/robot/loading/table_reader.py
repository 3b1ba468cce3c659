"""What the tables of a robot.toml name, in one model; refusals say where the table stands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp._text import find_repeated
from mbocp.exceptions import RobotFileError
from mbocp.robot import joints, kinematics
from mbocp.robot.loading.locking import refuse_follower
from mbocp.robot.parts import Connector


@dataclass(frozen=True)
class TableReader:
    """Names of joints and frames as indices of one model.

    Parameters
    ----------
    model : pin.Model
        After locking.
    locked : tuple of str
        Names of the joints that were locked.
    robot : str
        Name for messages.
    file : Path
        Where the tables stand, for messages.
    q0 : ndarray, shape (nq,)
        Initial pose; lengths that are not given are measured there.
    """

    model: pin.Model
    locked: tuple[str, ...]
    robot: str
    file: Path
    q0: Array

    def joint(self, name: str) -> int:
        """Index of a joint that moves by itself. Raises `UnknownJoint`; refuses mimic joints."""
        joint = joints.joint_id(self.model, name, self.robot)
        refuse_follower(self.model, joint, self.robot)
        return joint

    def frame(self, name: str) -> int:
        """Index of a frame by name. Raises `UnknownFrame`."""
        return kinematics.frame_id(self.model, name, self.robot)

    def moving_frame(self, name: str, key: str, consequence: str = "") -> int:
        """Index of a frame that is not fixed to the world; `key` and `consequence` are for the message."""
        frame = self.frame(name)
        if self.model.frames[frame].parentJoint == 0:
            self.refuse(key, f"frame {name!r} is fixed to the world{consequence}")
        return frame

    def pair(self, names: tuple[str, str], where: str) -> tuple[int, int]:
        """Indices of two frames by name, which must be on bodies that move against each other."""
        a, b = (self.frame(name) for name in names)
        if self.model.frames[a].parentJoint == self.model.frames[b].parentJoint:
            self.refuse(where, f"frames {names[0]!r} and {names[1]!r} are on the same rigid body")
        return a, b

    def distance(self, a: int, b: int) -> float:
        """Distance of the origins of two frames at the initial pose [m]."""
        pair = Connector(a, b, "line")
        return float(np.linalg.norm(kinematics.distances(self.model, self.q0, [pair])[0]))

    def refuse_repetition(self, what: str, names: Sequence[str]) -> None:
        """Refuse a name that several elements have."""
        if repeated := find_repeated(names):
            self.refuse(what, f"the name {repeated[0]!r} is given twice")

    def refuse(self, key: str, reason: str) -> NoReturn:
        """Raise the error for a key of the file."""
        raise RobotFileError(self.file, reason, key)
