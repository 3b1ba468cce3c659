"""From the tables of a robot.toml to motors, wrenches, thrusters and drives of one model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot import joints, kinematics
from mbocp.robot.loading.actuator_tables import JointActuator, Thruster, Wrench
from mbocp.robot.loading.drive_tables import DriveReader
from mbocp.robot.loading.limits import limit_of
from mbocp.robot.loading.schema import RobotTable
from mbocp.robot.loading.table_reader import TableReader
from mbocp.robot.parts import Actuation, FrameActuator, Label

_EFFORT_UNITS = {"m": "N", "rad": "N m"}


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
