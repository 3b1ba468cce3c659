"""From the [[drive]] tables of a robot.toml to drives of one model; each refusal by name."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mbocp._arrays import Array
from mbocp.robot import joints
from mbocp.robot.loading.actuator_tables import DriveTable
from mbocp.robot.loading.limits import limit_of
from mbocp.robot.loading.table_reader import TableReader
from mbocp.robot.parts import Drive

_SPEEDS = {"m": "m/s", "rad": "rad/s"}


@dataclass(frozen=True)
class DriveReader:
    """The [[drive]] tables of a robot.toml, made into indices of one model.

    Parameters
    ----------
    names : TableReader
        A drive of a joint that was locked is left out.
    tables : tuple of DriveTable
        The [[drive]] tables, in the order of the controls.
    """

    names: TableReader
    tables: tuple[DriveTable, ...]

    def driven(self) -> frozenset[int]:
        """Indices of the joints that drives move."""
        return frozenset(
            joint for number, table in enumerate(self.tables) for _, joint in self._joints(number, table)
        )

    def drives(self, motors: Array) -> list[tuple[Drive, float]]:
        """Drives, each with the limit of its control.

        Parameters
        ----------
        motors : ndarray, shape (nv, any)
            The constant part of B: no column may act on driven components alone.
        """
        found: list[tuple[Drive, float]] = []
        owner: dict[int, str] = {}
        driven = [dof for joint in self.driven() for dof in self._dofs(joint)]
        idle = np.delete(motors, driven, axis=0) == 0.0
        without_effect = motors[:, idle.all(axis=0)]
        for number, table in enumerate(self.tables):
            moved = list(self._joints(number, table))
            if not moved:
                continue
            drive, limit = self._drive(number, table, [joint for _, joint in moved])
            for key, joint in moved:
                for dof in self._dofs(joint):
                    self._refuse_second_cause(key, joint, owner.get(dof), bool(np.any(without_effect[dof])))
                    owner[dof] = drive.name
            found.append((drive, limit))
        return found

    def _joints(self, number: int, table: DriveTable) -> Iterator[tuple[str, int]]:
        """Key of the table and index of each joint that a drive moves; none if they are locked."""
        names = table.joints or [table.joint or ""]
        key = f"drive[{number}].{'joints' if table.joints else 'joint'}"
        locked = [name for name in names if name in self.names.locked]
        if locked and len(locked) < len(names):
            self.names.refuse(key, f"joint {locked[0]!r} is locked: lock all joints of a drive or none")
        repeated = [name for name in names if names.count(name) > 1]
        if repeated:
            self.names.refuse(key, f"joint {repeated[0]!r} is named twice")
        for name in names if not locked else ():
            yield key, self.names.joint(name)

    def _drive(self, number: int, table: DriveTable, moved: list[int]) -> tuple[Drive, float]:
        dofs = tuple(dof for joint in moved for dof in self._dofs(joint))
        if table.frame is not None:
            frame = self._frame(number, table.frame)
            direction = np.array(table.direction) / np.linalg.norm(np.array(table.direction))
            speed, limit = _SPEEDS["m"], np.inf
        else:
            frame, direction = None, np.zeros(3)
            kind, name = joints.joint_kind(self.names.model, moved[0]), self.names.model.names[moved[0]]
            if len(dofs) != 1:
                self.names.refuse(
                    f"drive[{number}].joint",
                    f"joint {name!r} is {kind.word} and has {len(dofs)} velocities: drive one of its frames "
                    "along a direction (frame, direction, joints)",
                )
            speed, limit = _SPEEDS[kind.v[0][1]], float(self.names.model.upperVelocityLimit[dofs[0]])
        unit, from_urdf = (speed, limit) if table.control == "velocity" else (f"{speed}^2", np.inf)
        limit = table.limit or limit_of(from_urdf)
        name = table.name or table.joint or table.frame or ""
        return Drive(name, table.control, dofs, frame, direction, unit, speed), limit

    def _frame(self, number: int, name: str) -> int:
        frame = self.names.frame(name)
        if self.names.model.frames[frame].parentJoint == 0:
            self.names.refuse(f"drive[{number}].frame", f"frame {name!r} is fixed to the world")
        return frame

    def _dofs(self, joint: int) -> range:
        where = joints.velocity_slice(self.names.model, joint)
        return range(where.start, where.stop)

    def _refuse_second_cause(self, key: str, joint: int, other: str | None, motor: bool) -> None:
        name = self.names.model.names[joint]
        if other is not None:
            self.names.refuse(key, f"joint {name!r} is already moved by drive {other!r}")
        if motor:
            self.names.refuse(
                key,
                f"joint {name!r} has a motor, too: a drive prescribes its motion whatever the force. Take it "
                "out of [actuation] joints, [[actuator]] or the option actuated, or drop the drive",
            )
