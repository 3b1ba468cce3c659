"""From the tables of a robot.toml to motors, wrenches, thrusters and drives of one model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import product
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp._measured import plain_number
from mbocp._text import find_repeated
from mbocp.exceptions import RobotError, UnsupportedRobot
from mbocp.robot import joints, kinematics
from mbocp.robot.loading.joint_numbers import limit_of, range_of
from mbocp.robot.loading.robot_tables import MotorTable, motor_of
from mbocp.robot.loading.robot_toml import DriveTable, JointActuator, RobotTable, Tendon, Thruster, Wrench
from mbocp.robot.loading.table_types import TableReader
from mbocp.robot.named_numbers import put_motors
from mbocp.robot.parts import Actuation, Drive, FrameActuator, Label, Motor
from mbocp.robot.robot import Robot
from mbocp.robot.rotors import unit_rotors

_SPEEDS = {"m": "m/s", "rad": "rad/s"}
_EFFORT_UNITS = {"m": "N", "rad": "N m"}
_RATE_UNITS = {"m": "m/s^2", "rad": "rad/s^2"}  # of robots without dynamics


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

    def find_driven_joints(self) -> frozenset[int]:
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
        driven = [dof for joint in self.find_driven_joints() for dof in self._dofs(joint)]
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
        if len(locked) == len(names):
            return
        if locked:
            self.names.refuse(key, f"joint {locked[0]!r} is locked: lock all joints of a drive or none")
        if repeated := find_repeated(names):
            self.names.refuse(key, f"joint {repeated[0]!r} is named twice")
        yield from ((key, self.names.joint(name)) for name in names)

    def _drive(self, number: int, table: DriveTable, moved: list[int]) -> tuple[Drive, float]:
        dofs = tuple(dof for joint in moved for dof in self._dofs(joint))
        if table.frame is not None:
            frame = self.names.read_moving_frame(table.frame, f"drive[{number}].frame")
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
        unit, own = (speed, limit) if table.control == "velocity" else (f"{speed}^2", np.inf)
        limit = limit_of(own)
        if table.limit is not None:
            limit = plain_number(table.limit, unit, f"drive[{number}].limit")
        name = table.name or table.joint or table.frame or ""
        return Drive(name, table.control, dofs, frame, direction, unit, speed), limit

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


_Sides: TypeAlias = tuple[float, float]  # the least and the largest control
_Column: TypeAlias = tuple[Array, Label, _Sides]  # of B where it is constant, its control and its limits


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
        """B and the drives, and the least and largest control, shape (nu, 2) [N m, N; m/s, m/s^2 of drives].

        Parameters
        ----------
        actuated : sequence of str or None
            Joints with motors; None: those of the table; if that names none, all that the file actuates and
            that no drive moves.
        """
        reader = DriveReader(self.names, tuple(self.table.drives))
        fixed, varying = self._columns(self._find_actuated_joints(actuated, reader))
        columns = [column for column, _, _ in fixed]
        selection = np.column_stack(columns) if columns else np.zeros((self.names.model.nv, 0))
        pairs = reader.drives(selection)
        frames, drives = tuple(made for made, _ in varying), tuple(made for made, _ in pairs)
        own = (*(Label(m.name, m.unit) for m in frames), *(Label(m.name, m.unit) for m in drives))
        labels = (*(label for _, label, _ in fixed), *own)
        self.names.refuse_repetition(
            "actuator or drive" if drives else "actuator", [label.name for label in labels]
        )
        driven = [(drive, (-limit, limit)) for drive, limit in pairs]
        limits = [column[-1] for column in fixed] + [pair[-1] for pair in (*varying, *driven)]
        return Actuation(selection, labels, frames, drives), np.reshape(limits, (-1, 2))

    def motors(self, actuated: Sequence[str] | None) -> list[str]:
        """Names of the joints that have motors, in the order of their controls."""
        reader = DriveReader(self.names, tuple(self.table.drives))
        return [self.names.model.names[joint] for joint in self._find_actuated_joints(actuated, reader)]

    def _find_actuated_joints(self, actuated: Sequence[str] | None, reader: DriveReader) -> list[int]:
        named = self.table.actuation.joints
        declared = [a.joint for a in self.table.actuators if isinstance(a, JointActuator)]
        if actuated is not None:
            named = list(actuated)
        elif named is not None or declared:
            named = [*(named or []), *declared]
        driven = reader.find_driven_joints()
        self._refuse_driven(driven)
        found = self._motors(named) if named is not None else self._default_motors(driven)
        return list(dict.fromkeys(self._elastic.get(joint, joint) for joint in found))

    @cached_property
    def _elastic(self) -> dict[int, int]:
        """Motors of elastic joints, by the joint; none before the model has them."""
        names = list(self.names.model.names)
        found = [row.joint for row in self.table.elastic if motor_of(row.joint) in names]
        return {names.index(joint): names.index(motor_of(joint)) for joint in found}

    def _refuse_driven(self, driven: frozenset[int]) -> None:
        for joint in sorted(driven & {*self._elastic, *self._elastic.values()}):
            name = self.names.model.names[joint]
            self.names.refuse("drive", f"joint {name!r} is elastic: its motor moves it by a spring")

    @cached_property
    def _effort_labels(self) -> tuple[Label, ...]:
        model = self.names.model
        forces, rates = (joints.velocity_labels(model, units) for units in (_EFFORT_UNITS, _RATE_UNITS))
        pairs = zip(forces, rates, unit_rotors(model), strict=True)
        return tuple(rate if is_rate else force for force, rate, is_rate in pairs)

    def _default_motors(self, driven: frozenset[int]) -> list[int]:
        count = range(1, self.names.model.njoints)
        return [j for j in count if joints.joint_kind(self.names.model, j).actuated and j not in driven]

    def _motors(self, named: Sequence[str]) -> list[int]:
        return [self.names.joint(name) for name in dict.fromkeys(named) if name not in self.names.locked]

    def _columns(self, motors: Iterable[int]) -> tuple[list[_Column], list[tuple[FrameActuator, _Sides]]]:
        """Constant columns of B, and actuators whose columns depend on q, with their limits."""
        declared = {a.joint: a.effort for a in self.table.actuators if isinstance(a, JointActuator)}
        fixed, varying = list[_Column](), list[tuple[FrameActuator, _Sides]]()
        moved = {motor: joint for joint, motor in self._elastic.items()}
        for joint in motors:
            name = self.names.model.names[moved.get(joint, joint)]
            fixed += self._of_joint(joint, declared.get(name))
        for number, row in enumerate(self.table.actuators):
            if isinstance(row, JointActuator):
                continue
            if isinstance(row, Tendon):
                fixed += self._of_tendon(row, f"actuator[{number}]")
                continue
            frame = self.names.read_moving_frame(
                row.frame, f"actuator[{number}].frame", ": nothing would move"
            )
            jacobian = self._constant_jacobian(frame)
            for label, direction, effort in _directions(row):
                if jacobian is not None:
                    fixed.append((jacobian.T @ direction, label, effort))
                else:
                    varying.append((FrameActuator(label.name, frame, direction, label.unit), effort))
        return fixed, varying

    def _of_joint(self, joint: int, effort: float | _Sides | None) -> Iterator[_Column]:
        where = joints.velocity_slice(self.names.model, joint)
        labels, model = self._effort_labels[where], self.names.model
        limits = zip(model.lowerEffortLimit[where], model.upperEffortLimit[where], strict=True)
        if effort is not None:
            for label, side in product(labels, _sides(effort)):
                plain_number(side, label.unit, f"actuator: effort of {label.name!r}")
        for index, label, limit in zip(range(where.start, where.stop), labels, limits, strict=True):
            column = np.zeros(self.names.model.nv)  # a row of np.eye would keep the whole matrix
            column[index] = 1.0
            yield column, label, range_of(*limit) if effort is None else _sides(effort)

    def _of_tendon(self, row: Tendon, key: str) -> Iterator[_Column]:
        """None if all its joints are locked."""
        model, units, column = self.names.model, set[str](), np.zeros(self.names.model.nv)
        if row.name in model.names:
            self.names.refuse(f"{key}.name", f"{row.name!r} is the name of a joint")
        for name, ratio in zip(row.joints, row.ratios, strict=True):
            if name in self.names.locked:
                continue
            joint = self.names.joint(name)
            kind = joints.joint_kind(model, joint)
            if len(kind.v) != 1:
                words = f"joint {name!r} is {kind.word} and has {len(kind.v)} velocities"
                self.names.refuse(f"{key}.joints", words)
            column[joints.velocity_slice(model, self._elastic.get(joint, joint))] = ratio
            units.add(_EFFORT_UNITS[kind.v[0][1]])
        if column.any():
            label = Label(row.name, "N m" if units == {"N m"} else "N")
            plain_number(max(map(abs, _sides(row.effort or np.inf))), label.unit, f"{key}.effort")
            yield column, label, _sides(row.effort or np.inf)

    def _constant_jacobian(self, frame: int) -> Array | None:
        """A frame's Jacobian in its own axes, shape (6, nv), if no configuration changes it."""
        model = self.names.model
        if not self._is_constant(model.frames[frame].parentJoint):
            return None
        return kinematics.frame_jacobian(model, pin.neutral(model), frame, pin.LOCAL)

    def _is_constant(self, parent: int) -> bool:
        """Whether a body's local Jacobian is constant: it hangs on a free-flyer alone, or it only slides."""
        chain = [j for j in self.names.model.supports[parent] if j != 0]
        kinds = [joints.joint_kind(self.names.model, j).word for j in chain]
        return kinds == ["floating"] or all(kind in ("prismatic", "translation") for kind in kinds)


def _sides(effort: float | _Sides) -> _Sides:
    """The least and the largest control, where one number stands for both."""
    return effort if isinstance(effort, tuple) else (-effort, effort)


def _directions(table: Wrench | Thruster) -> list[tuple[Label, Array, _Sides]]:
    """Label, wrench for u = 1 in the frame's axes, limits of each control."""
    name = table.name or table.frame
    if isinstance(table, Thruster):
        axis = np.array(table.axis) / np.linalg.norm(table.axis)
        moment = np.cross(table.position, axis) + table.torque_ratio * axis
        return [(Label(name, "N"), np.concatenate([axis, moment]), _sides(table.effort or np.inf))]
    order = ("fx", "fy", "fz", "mx", "my", "mz")
    efforts = (
        table.effort if isinstance(table.effort, list) else [table.effort or np.inf] * len(table.components)
    )
    found = []
    for c, effort in zip(table.components, efforts, strict=True):
        label = Label(f"{name}.{c}", "N" if c[0] == "f" else "N m")
        limit = plain_number(effort, label.unit, f"actuator: effort of {label.name!r}")
        found.append((label, np.eye(6)[order.index(c)], _sides(limit)))
    return found


def with_gears(robot: Robot, rows: Sequence[MotorTable], gone: Sequence[str]) -> Robot:
    """Return the robot with gears between motors and joints; limits that are not said stay those of joints.

    Raises
    ------
    RobotError
        For a joint that is named twice, and one that no motor turns.
    """
    motors, limits = dict[str, Motor](), robot.limits
    efforts = np.column_stack([limits.effort_lower, limits.effort])
    labels = [label.name if label.unit == "N m" else "" for label in robot.u_labels]
    for number, row in enumerate(rows):
        where = f"robot {robot.name!r}: motor[{number}].joint"
        if row.joint in gone:
            continue
        if row.joint in motors:
            raise RobotError(f"{where}: {row.joint!r} is named twice")
        dof, n = robot.velocity_indices(row.joint).start, row.gear_ratio
        if row.joint not in labels:
            raise UnsupportedRobot(f"{where}: got {row.joint!r}, expected a joint that its own motor turns")
        column, limit = labels.index(row.joint), robot.limits.velocity[dof]
        inertia = robot.model.armature[dof] / n**2 if row.inertia is None else row.inertia
        efforts[column] = efforts[column] / n if row.effort is None else _sides(row.effort)
        speed = limit * n if row.speed is None else row.speed
        motors[row.joint] = Motor(row.joint, dof, column, n, float(inertia), float(speed))
    limits = replace(limits, effort_lower=efforts[:, 0], effort=efforts[:, 1])
    return put_motors(replace(robot, limits=limits), tuple(motors.values()))
