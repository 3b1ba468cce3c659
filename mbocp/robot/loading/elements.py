"""From the tables of a robot.toml and a model to actuation, constraints, forces, limits and connectors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.exceptions import UnknownFrame, UnknownJoint
from mbocp.robot import joints
from mbocp.robot.collision.source import CollisionSphere
from mbocp.robot.loading.actuation import ActuationReader
from mbocp.robot.loading.schema import RobotTable
from mbocp.robot.loading.table_reader import TableReader
from mbocp.robot.loops.constraints import Constraint
from mbocp.robot.parts import (
    Actuation,
    Connector,
    QuarticSpring,
    SpringDamper,
)

_MIN_LENGTH = 1e-9  # [m] of a spring whose coefficient is its stiffness by the square of its length
_STEEL, _BRASS = (0.35, 0.35, 0.38, 1.0), (0.75, 0.5, 0.15, 1.0)
_LOOKS = {"rod": (0.02, _STEEL), "spring": (0.06, _BRASS), "line": (0.005, _STEEL)}


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
    """

    model: pin.Model
    locked: tuple[str, ...]
    q0: Array
    table: RobotTable
    robot: str
    file: Path

    def actuation(self, actuated: Sequence[str] | None) -> tuple[Actuation, Array]:
        """B and the drives, and the limit of each control, see `ActuationReader`."""
        return ActuationReader(self._names, self.table).actuation(actuated)

    def motors(self, actuated: Sequence[str] | None) -> list[str]:
        """Names of the joints that have motors, in the order of their controls."""
        return ActuationReader(self._names, self.table).motors(actuated)

    def constraints(self) -> tuple[Constraint, ...]:
        """Holonomic constraints."""
        found = []
        for number, table in enumerate(self.table.constraints):
            name = table.name or f"{table.type}_{number}"
            try:
                found.append(table.make(name, f"constraint[{number}]", self._names))
            except (UnknownFrame, UnknownJoint) as error:
                error.args = (f"constraint {name!r}: {error}",)
                raise
        self._names.refuse_repeated("constraint", [constraint.name for constraint in found])
        return tuple(found)

    def forces(self) -> tuple[QuarticSpring | SpringDamper, ...]:
        """Springs and dampers."""
        found: list[QuarticSpring | SpringDamper] = []
        for number, table in enumerate(self.table.springs):
            a, b = self._names.pair(table.frames, f"spring[{number}]")
            length = table.length or self._names.distance(a, b)
            if table.stiffness is not None and length < _MIN_LENGTH:
                told = "not given, and the frames coincide at the initial pose"
                if table.length is not None:
                    told = f"got {length:g} m, expected at least {_MIN_LENGTH:g} m"
                self._names.refuse(f"spring[{number}].length", told)
            # First paper, section 6.1: V_e = k/(8 l^2) (|d|^2 - l^2)^2
            coefficient = table.coefficient or (table.stiffness or 0.0) / (2.0 * length**2)
            found.append(
                QuarticSpring(table.name or f"spring_{number}", a, b, coefficient, length, table.frames)
            )
        for number, damper in enumerate(self.table.spring_dampers):
            a, b = self._names.pair(damper.frames, f"spring_damper[{number}]")
            length = self._names.distance(a, b) if damper.length is None else damper.length
            name = damper.name or f"spring_damper_{number}"
            found.append(SpringDamper(name, a, b, damper.stiffness, damper.damping, length, damper.frames))
        self._names.refuse_repeated("spring or spring_damper", [force.name for force in found])
        return tuple(found)

    def connectors(
        self, constraints: Iterable[Constraint], forces: Iterable[QuarticSpring | SpringDamper]
    ) -> tuple[Connector, ...]:
        """Connectors in a replay: those of the [[visual]] tables, else a rod or coil for each pair."""
        shown: dict[tuple[int, ...], Connector | None] = {}
        # Frames of other constraints are at one place, or the constraint is visible anyway.
        pairs = [(c.frame_ids, c.connector) for c in constraints if c.connector is not None]
        pairs += [((force.frame_a, force.frame_b), "spring") for force in forces]
        for (a, b), kind in pairs:
            radius, color = _LOOKS[kind]
            shown[_key(a, b)] = Connector(a, b, kind, radius, color)
        for number, table in enumerate(self.table.visuals):
            a, b = self._names.pair(table.frames, f"visual[{number}]")
            radius, color = _LOOKS.get(table.type, _LOOKS["line"])
            rgba = color if table.color is None else _rgba(table.color)
            connector = Connector(a, b, table.type, table.radius or radius, rgba)
            shown[_key(a, b)] = None if table.type == "none" else connector
        return tuple(c for c in shown.values() if c is not None)

    def collision_spheres(self) -> tuple[CollisionSphere, ...]:
        """Spheres that stand for the shapes of links."""
        for number, row in enumerate(self.table.collision_spheres):
            try:
                self._names.frame(row.frame)
            except UnknownFrame as error:
                error.args = (f"{self.file}: collision_sphere[{number}].frame: {error}",)
                raise
        return tuple(CollisionSphere(s.frame, s.center, s.radius) for s in self.table.collision_spheres)

    def trace_frames(self) -> tuple[str, ...]:
        """Frames to trace: those of the table, else the floating base or the tip of the longest chain."""
        if self.table.trace is not None:
            for name in self.table.trace:
                self._names.frame(name)
            return tuple(self.table.trace)
        floating = joints.joint_kind(self.model, 1).word == "floating"
        depths = [len(support) for support in self.model.supports]
        tip = 1 if floating else int(np.argmax(depths))
        bodies = [f.name for f in self.model.frames if f.parentJoint == tip and f.type == pin.FrameType.BODY]
        return tuple(bodies[:1] if floating else bodies[-1:])

    @cached_property
    def _names(self) -> TableReader:
        return TableReader(self.model, self.locked, self.robot, self.file, self.q0)


def _rgba(color: Sequence[float]) -> tuple[float, float, float, float]:
    red, green, blue, *opacity = color
    return red, green, blue, opacity[0] if opacity else 1.0


def _key(a: int, b: int) -> tuple[int, ...]:
    return tuple(sorted((a, b)))
