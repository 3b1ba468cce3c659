"""From the tables of a robot.toml and a model to actuation, constraints, forces, limits and connectors."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.exceptions import RobotFileError, UnknownFrame, UnknownJoint
from mbocp.robot import joints, kinematics
from mbocp.robot.loading.drive_tables import DriveReader
from mbocp.robot.loading.locking import refuse_follower
from mbocp.robot.loading.mimic import Follower
from mbocp.robot.loading.schema import (
    ConstraintTable,
    CouplingTable,
    HingeTable,
    JointActuator,
    LineTable,
    PlaneTable,
    PointTable,
    RobotTable,
    RodTable,
    Thruster,
    Wrench,
)
from mbocp.robot.loops.constraints import (
    Constraint,
    Coupling,
    Hinge,
    Point,
    PointOnLine,
    PointOnPlane,
    Rod,
    Weld,
)
from mbocp.robot.parts import (
    Actuation,
    Connector,
    FrameActuator,
    Label,
    Limits,
    QuarticSpring,
    SpringDamper,
)
from mbocp.robot.warnings import NotModelledWarning

__all__ = ["Assembly"]

_EFFORT_UNITS = {"m": "N", "rad": "N m"}
_NO_LIMIT = 1e300  # Pinocchio's "no limit" is the largest double
_MIN_LENGTH = 1e-9  # [m] of a spring whose coefficient is its stiffness by the square of its length
_STEEL, _BRASS = (0.35, 0.35, 0.38, 1.0), (0.75, 0.5, 0.15, 1.0)
_LOOKS = {"rod": (0.02, _STEEL), "spring": (0.06, _BRASS), "line": (0.005, _STEEL)}


@dataclass
class _Columns:
    """Columns of B while they are gathered: the constant ones, then those that depend on q."""

    fixed: list[Array] = field(default_factory=list)
    fixed_labels: list[Label] = field(default_factory=list)
    fixed_efforts: list[float] = field(default_factory=list)
    frames: list[FrameActuator] = field(default_factory=list)
    frame_efforts: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Assembly:
    """Tables that name joints and frames, resolved to indices of one model.

    Parameters
    ----------
    model : pin.Model
        After locking.
    locked : tuple of str
        Names of the joints that were locked: they may still be named as actuated, and then have no control.
    q0 : ndarray, shape (nq,)
        Initial pose; lengths that are not given are measured there.
    table : RobotTable
        The robot.toml, or its defaults.
    robot : str
        Name for messages.
    file : Path
        Where the table stands, for messages.
    followers : tuple of Follower
        Mimic joints of the model, whose limits are limits of their leaders.
    """

    model: pin.Model
    locked: tuple[str, ...]
    q0: Array
    table: RobotTable
    robot: str
    file: Path
    followers: tuple[Follower, ...] = ()

    # Actuation

    def actuation(self, actuated: Sequence[str] | None) -> tuple[Actuation, Array]:
        """B and the drives, and the limit of each control [N m, N; m/s, m/s^2, ... of drives].

        Parameters
        ----------
        actuated : sequence of str or None
            Joints with motors; None: those of the table; if that names none, all that the URDF actuates and
            that no drive moves.
        """
        columns = _Columns()
        reader = DriveReader(self.model, self.locked, tuple(self.table.drives), self.robot, self.file)
        declared = {a.joint: a.effort for a in self.table.actuators if isinstance(a, JointActuator)}
        named = self.table.actuation.joints
        if actuated is not None:
            named = list(actuated)
        elif named is not None or declared:
            named = [*(named or []), *declared]
        for joint in self._motors(named) if named is not None else self._default_motors(reader.driven()):
            self._add_joint(columns, joint, declared.get(self.model.names[joint]))
        for number, table in enumerate(self.table.actuators):
            if isinstance(table, Wrench | Thruster):
                self._add_wrench(columns, table, number)
        selection = np.column_stack(columns.fixed) if columns.fixed else np.zeros((self.model.nv, 0))
        pairs = reader.drives(selection)
        drives = tuple(drive for drive, _ in pairs)
        named_units = [(a.name, a.unit) for a in columns.frames] + [(d.name, d.unit) for d in drives]
        labels = (*columns.fixed_labels, *(Label(*pair) for pair in named_units))
        self._refuse_repeated("actuator or drive" if drives else "actuator", [label.name for label in labels])
        actuation = Actuation(selection, labels, tuple(columns.frames), drives)
        limits = [*columns.fixed_efforts, *columns.frame_efforts, *(limit for _, limit in pairs)]
        return actuation, np.array(limits)

    @cached_property
    def _effort_labels(self) -> tuple[Label, ...]:
        return joints.velocity_labels(self.model, _EFFORT_UNITS)

    def _default_motors(self, driven: frozenset[int]) -> list[int]:
        count = range(1, self.model.njoints)
        return [j for j in count if joints.joint_kind(self.model, j).actuated and j not in driven]

    def _motors(self, named: Sequence[str]) -> list[int]:
        found = []
        for name in dict.fromkeys(named):
            if name in self.locked:
                continue
            joint = joints.joint_id(self.model, name, self.robot)
            refuse_follower(self.model, joint, self.robot)
            found.append(joint)
        return found

    def _add_joint(self, columns: _Columns, joint: int, effort: float | None) -> None:
        where = joints.velocity_slice(self.model, joint)
        labels = self._effort_labels[where]
        limits = self.model.upperEffortLimit[where]
        for index, label, limit in zip(range(where.start, where.stop), labels, limits, strict=True):
            column = np.zeros(self.model.nv)  # a row of np.eye would keep the whole matrix
            column[index] = 1.0
            columns.fixed.append(column)
            columns.fixed_labels.append(label)
            columns.fixed_efforts.append(_limit(limit) if effort is None else effort)

    def _add_wrench(self, columns: _Columns, table: Wrench | Thruster, number: int) -> None:
        frame = self.frame(table.frame)
        parent = self.model.frames[frame].parentJoint
        if parent == 0:
            self._refuse(
                f"actuator[{number}].frame",
                f"frame {table.frame!r} is fixed to the world: nothing would move",
            )
        for label, direction, effort in _directions(table):
            if self._is_constant(parent):
                jacobian = kinematics.frame_jacobian(self.model, pin.neutral(self.model), frame, pin.LOCAL)
                columns.fixed.append(jacobian.T @ direction)
                columns.fixed_labels.append(label)
                columns.fixed_efforts.append(effort)
            else:
                columns.frames.append(FrameActuator(label.name, frame, direction, label.unit))
                columns.frame_efforts.append(effort)

    def _is_constant(self, parent: int) -> bool:
        """Whether a body's local Jacobian is constant: it hangs on a free-flyer alone, or it only slides."""
        chain = [j for j in self.model.supports[parent] if j != 0]
        kinds = [joints.joint_kind(self.model, j).word for j in chain]
        return kinds == ["floating"] or all(kind in ("prismatic", "translation") for kind in kinds)

    # Constraints and forces

    def constraints(self) -> tuple[Constraint, ...]:
        """Holonomic constraints."""
        found = []
        for number, table in enumerate(self.table.constraints):
            name = table.name or f"{table.type}_{number}"
            try:
                found.append(self._constraint(table, f"constraint[{number}]", name))
            except (UnknownFrame, UnknownJoint) as error:
                error.args = (f"constraint {name!r}: {error}",)
                raise
        self._refuse_repeated("constraint", [constraint.name for constraint in found])
        return tuple(found)

    def _constraint(self, table: ConstraintTable, where: str, name: str) -> Constraint:
        if isinstance(table, CouplingTable):
            return self._coupling(table, where, name)
        a, b = self.pair(table.frames, where)
        if isinstance(table, RodTable):
            length = table.length or self._distance(a, b)
            if length <= 0.0:
                self._refuse(
                    f"{where}.length", "not given, and the frames coincide at the initial pose: give a length"
                )
            return Rod(name, a, b, length, table.frames)
        if isinstance(table, HingeTable):
            return Hinge(name, a, b, table.frames, table.axis, table.axis_b or table.axis)
        if isinstance(table, PlaneTable):
            return PointOnPlane(name, a, b, table.frames, table.normal)
        if isinstance(table, LineTable):
            return PointOnLine(name, a, b, table.frames, table.axis)
        return (Point if isinstance(table, PointTable) else Weld)(name, a, b, table.frames)

    def _coupling(self, table: CouplingTable, where: str, name: str) -> Coupling:
        for locked in (joint for joint in table.joints if joint in self.locked):
            self._refuse(
                f"{where}.joints", f"joint {locked!r} is locked: lock the other, too, or take this out"
            )
        a, b = (joints.joint_id(self.model, joint, self.robot) for joint in table.joints)
        for joint in (a, b):
            refuse_follower(self.model, joint, self.robot)
            kind = joints.joint_kind(self.model, joint)
            if len(kind.v) != 1:
                reason = f"joint {self.model.names[joint]!r} is {kind.word} and has {len(kind.v)} velocities"
                self._refuse(f"{where}.joints", f"{reason}; a coupling takes joints with one")
        kinds = [joints.joint_kind(self.model, joint) for joint in (a, b)]
        periodic = (not kinds[0].is_vector, not kinds[1].is_vector)
        unit = kinds[0].v[0][1]
        return Coupling(name, a, b, table.ratio, table.offset, table.joints, unit, periodic)

    def forces(self) -> tuple[QuarticSpring | SpringDamper, ...]:
        """Springs and dampers."""
        found: list[QuarticSpring | SpringDamper] = []
        for number, table in enumerate(self.table.springs):
            a, b = self.pair(table.frames, f"spring[{number}]")
            length = table.length or self._distance(a, b)
            if table.stiffness is not None and length < _MIN_LENGTH:
                told = "not given, and the frames coincide at the initial pose"
                if table.length is not None:
                    told = f"got {length:g} m, expected at least {_MIN_LENGTH:g} m"
                self._refuse(f"spring[{number}].length", told)
            # First paper, section 6.1: V_e = k/(8 l^2) (|d|^2 - l^2)^2
            coefficient = table.coefficient or (table.stiffness or 0.0) / (2.0 * length**2)
            found.append(
                QuarticSpring(table.name or f"spring_{number}", a, b, coefficient, length, table.frames)
            )
        for number, damper in enumerate(self.table.spring_dampers):
            a, b = self.pair(damper.frames, f"spring_damper[{number}]")
            length = self._distance(a, b) if damper.length is None else damper.length
            name = damper.name or f"spring_damper_{number}"
            found.append(SpringDamper(name, a, b, damper.stiffness, damper.damping, length, damper.frames))
        self._refuse_repeated("spring or spring_damper", [force.name for force in found])
        return tuple(found)

    def connectors(
        self, elements: Iterable[Constraint | QuarticSpring | SpringDamper]
    ) -> tuple[Connector, ...]:
        """Connectors in a replay: those of the [[visual]] tables, else a rod or coil for each pair."""
        shown: dict[tuple[int, ...], Connector | None] = {}
        for pair in elements:
            if not isinstance(pair, Rod | QuarticSpring | SpringDamper):
                continue  # frames of a closed loop are at one place, or the constraint is visible anyway
            kind = "rod" if isinstance(pair, Rod) else "spring"
            radius, color = _LOOKS[kind]
            shown[_key(pair.frame_a, pair.frame_b)] = Connector(
                pair.frame_a, pair.frame_b, kind, radius, color
            )
        for number, table in enumerate(self.table.visuals):
            a, b = self.pair(table.frames, f"visual[{number}]")
            radius, color = _LOOKS.get(table.type, _LOOKS["line"])
            rgba = color if table.color is None else _rgba(table.color)
            connector = Connector(a, b, table.type, table.radius or radius, rgba)
            shown[_key(a, b)] = None if table.type == "none" else connector
        return tuple(c for c in shown.values() if c is not None)

    # Limits and traces

    def limits(self, efforts: Array) -> Limits:
        """Bounds of the URDF; zero or contradictory ones mean none, swapped ones are put in order.

        Limits of a follower are limits of its leader, where they leave that one a range.
        """
        velocity = np.array([_limit(v) for v in self.model.upperVelocityLimit])
        lower, upper = np.full(self.model.nq, -np.inf), np.full(self.model.nq, np.inf)
        for joint in range(1, self.model.njoints):
            kind, where = joints.joint_kind(self.model, joint), joints.configuration_slice(self.model, joint)
            if not (kind.is_vector and kind.q):
                continue
            bounds = np.sort(
                [self.model.lowerPositionLimit[where], self.model.upperPositionLimit[where]], axis=0
            )
            bounds = np.where(np.abs(bounds) > _NO_LIMIT, np.copysign(np.inf, bounds), bounds)
            if (bounds[0] < bounds[1]).all():
                lower[where], upper[where] = bounds
        for follower in self.followers:
            self._limit_leader(follower, velocity, lower, upper)
        return Limits(efforts, velocity, lower, upper)

    def _limit_leader(self, follower: Follower, velocity: Array, lower: Array, upper: Array) -> None:
        """Narrow the leader's bounds in place."""
        leader = joints.joint_id(self.model, follower.leader, self.robot)
        dof = joints.velocity_slice(self.model, leader).start
        velocity[dof] = min(velocity[dof], follower.leader_velocity)
        if not joints.joint_kind(self.model, leader).is_vector:
            return
        at, (low, high) = joints.configuration_slice(self.model, leader).start, follower.leader_range
        if max(lower[at], low) < min(upper[at], high):
            lower[at], upper[at] = max(lower[at], low), min(upper[at], high)
        else:
            warnings.warn(
                f"robot {self.robot!r}: the position limits of {follower.name!r} leave {follower.leader!r}, "
                "which it mimics, nowhere to move: they are left out",
                NotModelledWarning,
                stacklevel=2,
            )

    def trace_frames(self) -> tuple[str, ...]:
        """Frames to trace: those of the table, else the floating base or the tip of the longest chain."""
        if self.table.trace is not None:
            for name in self.table.trace:
                self.frame(name)
            return tuple(self.table.trace)
        floating = joints.joint_kind(self.model, 1).word == "floating"
        depths = [len(support) for support in self.model.supports]
        tip = 1 if floating else int(np.argmax(depths))
        bodies = [f.name for f in self.model.frames if f.parentJoint == tip and f.type == pin.FrameType.BODY]
        return tuple(bodies[:1] if floating else bodies[-1:])

    # Names

    def frame(self, name: str) -> int:
        """Index of a frame by name. Raises `UnknownFrame`."""
        return kinematics.frame_id(self.model, name, self.robot)

    def pair(self, names: tuple[str, str], where: str) -> tuple[int, int]:
        """Indices of two frames by name, which must be on bodies that move against each other."""
        a, b = (self.frame(name) for name in names)
        if self.model.frames[a].parentJoint == self.model.frames[b].parentJoint:
            self._refuse(where, f"frames {names[0]!r} and {names[1]!r} are on the same rigid body")
        return a, b

    def _distance(self, a: int, b: int) -> float:
        pair = Connector(a, b, "line")
        return float(np.linalg.norm(kinematics.distances(self.model, self.q0, [pair])[0]))

    def _refuse_repeated(self, what: str, names: list[str]) -> None:
        repeated = [name for name in names if names.count(name) > 1]
        if repeated:
            self._refuse(what, f"the name {repeated[0]!r} is given twice")

    def _refuse(self, key: str, reason: str) -> None:
        raise RobotFileError(self.file, reason, key)


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


def _limit(value: float) -> float:
    """A limit of a URDF: many write zero where none is given."""
    return float(value) if 0.0 < value < _NO_LIMIT else np.inf


def _rgba(color: Sequence[float]) -> tuple[float, float, float, float]:
    red, green, blue, *opacity = color
    return red, green, blue, opacity[0] if opacity else 1.0


def _key(a: int, b: int) -> tuple[int, ...]:
    return tuple(sorted((a, b)))
