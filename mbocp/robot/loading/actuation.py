"""From the tables of a robot.toml to motors, wrenches, thrusters and drives of one model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot import joints, kinematics
from mbocp.robot.loading.limits import limit_of
from mbocp.robot.loading.schema import DriveTable, JointActuator, RobotTable, Thruster, Wrench
from mbocp.robot.loading.table_reader import TableReader
from mbocp.robot.parts import Actuation, Drive, FrameActuator, Label

_SPEEDS = {"m": "m/s", "rad": "rad/s"}
_EFFORT_UNITS = {"m": "N", "rad": "N m"}


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


@dataclass
class _Columns:
    """Columns of B while they are gathered: the constant ones, then those that depend on q."""

    fixed: list[Array] = field(default_factory=list)
    fixed_labels: list[Label] = field(default_factory=list)
    fixed_efforts: list[float] = field(default_factory=list)
    frames: list[FrameActuator] = field(default_factory=list)
    frame_efforts: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class ActuationReader:
    """The tables of a robot.toml that speak of controls.

    Parameters
    ----------
    names : TableReader
        Joints that were locked may still be named as actuated, and then have no control.
    table : RobotTable
        The robot.toml, or its defaults.
    """

    names: TableReader
    table: RobotTable

    def actuation(self, actuated: Sequence[str] | None) -> tuple[Actuation, Array]:
        """B and the drives, and the limit of each control [N m, N; m/s, m/s^2, ... of drives].

        Parameters
        ----------
        actuated : sequence of str or None
            Joints with motors; None: those of the table; if that names none, all that the URDF actuates and
            that no drive moves.
        """
        columns = _Columns()
        reader = DriveReader(self.names, tuple(self.table.drives))
        declared = {a.joint: a.effort for a in self.table.actuators if isinstance(a, JointActuator)}
        for joint in self._actuated(actuated, reader):
            self._add_joint(columns, joint, declared.get(self.names.model.names[joint]))
        for number, table in enumerate(self.table.actuators):
            if isinstance(table, Wrench | Thruster):
                self._add_wrench(columns, table, number)
        selection = np.column_stack(columns.fixed) if columns.fixed else np.zeros((self.names.model.nv, 0))
        pairs = reader.drives(selection)
        drives = tuple(drive for drive, _ in pairs)
        named_units = [(a.name, a.unit) for a in columns.frames] + [(d.name, d.unit) for d in drives]
        labels = (*columns.fixed_labels, *(Label(*pair) for pair in named_units))
        self.names.refuse_repeated(
            "actuator or drive" if drives else "actuator", [label.name for label in labels]
        )
        actuation = Actuation(selection, labels, tuple(columns.frames), drives)
        limits = [*columns.fixed_efforts, *columns.frame_efforts, *(limit for _, limit in pairs)]
        return actuation, np.array(limits)

    def motors(self, actuated: Sequence[str] | None) -> list[str]:
        """Names of the joints that have motors, in the order of their controls."""
        reader = DriveReader(self.names, tuple(self.table.drives))
        return [self.names.model.names[joint] for joint in self._actuated(actuated, reader)]

    def _actuated(self, actuated: Sequence[str] | None, reader: DriveReader) -> list[int]:
        named = self.table.actuation.joints
        declared = [a.joint for a in self.table.actuators if isinstance(a, JointActuator)]
        if actuated is not None:
            named = list(actuated)
        elif named is not None or declared:
            named = [*(named or []), *declared]
        return self._motors(named) if named is not None else self._default_motors(reader.driven())

    @cached_property
    def _effort_labels(self) -> tuple[Label, ...]:
        return joints.velocity_labels(self.names.model, _EFFORT_UNITS)

    def _default_motors(self, driven: frozenset[int]) -> list[int]:
        count = range(1, self.names.model.njoints)
        return [j for j in count if joints.joint_kind(self.names.model, j).actuated and j not in driven]

    def _motors(self, named: Sequence[str]) -> list[int]:
        return [self.names.joint(name) for name in dict.fromkeys(named) if name not in self.names.locked]

    def _add_joint(self, columns: _Columns, joint: int, effort: float | None) -> None:
        where = joints.velocity_slice(self.names.model, joint)
        labels = self._effort_labels[where]
        limits = self.names.model.upperEffortLimit[where]
        for index, label, limit in zip(range(where.start, where.stop), labels, limits, strict=True):
            column = np.zeros(self.names.model.nv)  # a row of np.eye would keep the whole matrix
            column[index] = 1.0
            columns.fixed.append(column)
            columns.fixed_labels.append(label)
            columns.fixed_efforts.append(limit_of(limit) if effort is None else effort)

    def _add_wrench(self, columns: _Columns, table: Wrench | Thruster, number: int) -> None:
        model, frame = self.names.model, self.names.frame(table.frame)
        parent = model.frames[frame].parentJoint
        if parent == 0:
            self.names.refuse(
                f"actuator[{number}].frame",
                f"frame {table.frame!r} is fixed to the world: nothing would move",
            )
        for label, direction, effort in _directions(table):
            if self._is_constant(parent):
                jacobian = kinematics.frame_jacobian(
                    self.names.model, pin.neutral(self.names.model), frame, pin.LOCAL
                )
                columns.fixed.append(jacobian.T @ direction)
                columns.fixed_labels.append(label)
                columns.fixed_efforts.append(effort)
            else:
                columns.frames.append(FrameActuator(label.name, frame, direction, label.unit))
                columns.frame_efforts.append(effort)

    def _is_constant(self, parent: int) -> bool:
        """Whether a body's local Jacobian is constant: it hangs on a free-flyer alone, or it only slides."""
        chain = [j for j in self.names.model.supports[parent] if j != 0]
        kinds = [joints.joint_kind(self.names.model, j).word for j in chain]
        return kinds == ["floating"] or all(kind in ("prismatic", "translation") for kind in kinds)


def _directions(table: Wrench | Thruster) -> list[tuple[Label, Array, float]]:
    """Label, wrench for u = 1 in the frame's axes, effort limit of each control."""
    name = table.name or table.frame
    if isinstance(table, Thruster):
        axis = np.array(table.axis) / np.linalg.norm(table.axis)
        moment = np.cross(table.position, axis) + table.torque_ratio * axis
        return [(Label(name, "N"), np.concatenate([axis, moment]), table.effort or np.inf)]
    order = ("fx", "fy", "fz", "mx", "my", "mz")
    efforts = (
        table.effort if isinstance(table.effort, list) else [table.effort or np.inf] * len(table.components)
    )
    return [
        (Label(f"{name}.{c}", "N" if c[0] == "f" else "N m"), np.eye(6)[order.index(c)], effort)
        for c, effort in zip(table.components, efforts, strict=True)
    ]
