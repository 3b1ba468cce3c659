"""What a reader makes of a robot's file, whatever its format, before joints are locked."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp._measured import plain_numbers
from mbocp.exceptions import DimensionMismatch
from mbocp.robot import joints
from mbocp.robot.collision.geometry import ShapeSource
from mbocp.robot.loading.joint_numbers import Losses, MimicJoint
from mbocp.robot.loading.locking import pose_by_joint
from mbocp.robot.loading.robot_tables import InertiasTable
from mbocp.robot.loading.robot_toml import RobotTable
from mbocp.robot.payload import LinkInertia, Payload
from mbocp.robot.placed import PlacedRobot

ROOT_JOINT = "root_joint"  # the free-flyer under a root link that floats
_NO_TABLES = RobotTable.model_construct()
_BASE_NQ = 7  # numbers of its configuration


class Oddity(NamedTuple):
    """What is allowed and probably not meant, of a joint, a link, or (both are "") the file.

    `key` of problem files says otherwise, where one does.
    """

    words: str
    joint: str = ""
    link: str = ""
    key: str = ""


@dataclass(frozen=True)
class ReadOptions:
    """How a file is read.

    Attributes
    ----------
    free_flyer : bool, optional
        Whether the root link floats; None: as the file says.
    mimic : bool, optional
        Whether mimic joints follow their leaders; None: as is usual in the format.
    folders : tuple of Path
        That hold packages of meshes.
    inertias : InertiasTable, optional
        Where masses and inertias come from that the file does not give.
    """

    free_flyer: bool | None = None
    mimic: bool | None = None
    folders: tuple[Path, ...] = ()
    inertias: InertiasTable | None = None


@dataclass(frozen=True, eq=False)
class Description:
    """A robot as its file describes it.

    Parameters
    ----------
    name : str
    file : Path
        Where its tables stand, for messages.
    model : pin.Model
        Tree of joints and inertias; the losses and limits of joints are those of the file.
    visuals : pin.GeometryModel
        Shapes and paths of the meshes that were found.
    q0 : ndarray, shape (nq,)
        Pose that it comes with.
    table : RobotTable
        Tables of a robot.toml, or their defaults: motors, loops, springs, locked joints, initial pose.
    source : Path, optional
        File that the model was read from; None if it was made in memory.
    followers : tuple of MimicJoint
        Mimic joints of the model.
    shapes : tuple of ShapeSource
        What links collide with.
    parts : tuple of PlacedRobot
        Robots that it is made of; empty for a single one.
    losses : tuple of Losses
        Damping and friction that act.
    carried : tuple of Payload
    link_inertias : tuple of LinkInertia
        Those that stand in `model` in place of what the file gives.
    named_locks : frozenset of str
        Joints that options lock: other values of theirs are other numbers of the same functions.
    """

    name: str
    file: Path
    model: pin.Model
    visuals: pin.GeometryModel
    q0: Array
    table: RobotTable = _NO_TABLES
    source: Path | None = None
    followers: tuple[MimicJoint, ...] = ()
    shapes: tuple[ShapeSource, ...] = ()
    parts: tuple[PlacedRobot, ...] = ()
    losses: tuple[Losses, ...] = ()
    carried: tuple[Payload, ...] = ()
    link_inertias: tuple[LinkInertia, ...] = ()
    named_locks: frozenset[str] = frozenset()

    @cached_property
    def pose(self) -> Array:
        """Initial pose: the one that it comes with, and [initial] q on it, shape (nq,)."""
        model, initial = self.model, self.table.initial
        if initial is None:
            return self.q0
        if isinstance(initial.q, dict):
            return pose_by_joint(model, self.q0, initial.q, self.name)
        # The option free_flyer may differ from the file.
        floats, meant = ROOT_JOINT in model.names, bool(self.table.free_flyer)
        values = initial.q[_BASE_NQ:] if meant and not floats else initial.q
        base = _BASE_NQ if floats and not meant else 0
        units = [(label.name, label.unit) for label in joints.position_labels(model)[base:]]
        given = np.array(plain_numbers(values, units, f"{self.file}: initial.q"))
        if given.shape != (model.nq - base,):
            raise DimensionMismatch(f"{self.file}: initial.q", given.shape, (model.nq - base,))
        q = np.concatenate([self.q0[:base], given])
        parts = {
            model.names[j]: q[joints.configuration_slice(model, j)].tolist()
            for j in range(1, model.njoints)
            if model.joints[j].nq > 0
        }
        return pose_by_joint(model, q, parts, self.name)  # each joint checks and normalises its own part

    @property
    def posed_joints(self) -> tuple[str, ...]:
        """Joints whose initial position was written."""
        initial = self.table.initial
        if initial is None:
            return ()
        return tuple(initial.q) if isinstance(initial.q, dict) else joints.joint_names(self.model)
