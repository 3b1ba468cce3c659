"""From the tables of a robot.toml and a model to constraints, forces, connectors and spheres."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pinocchio as pin

from mbocp.exceptions import UnknownFrame, UnknownJoint, locate
from mbocp.robot import joints
from mbocp.robot.collision.geometry import CollisionSphere
from mbocp.robot.loading.robot_toml import QuarticSpringTable, RobotTable
from mbocp.robot.loading.table_types import TableReader
from mbocp.robot.loops.kinds.constraint import Constraint
from mbocp.robot.parts import Connector, QuarticSpring, SpringDamper

_MIN_LENGTH = 1e-9  # [m] of a spring whose coefficient is its stiffness by the square of its length
_STEEL, _BRASS = (0.35, 0.35, 0.38, 1.0), (0.75, 0.5, 0.15, 1.0)
_LOOKS = {"rod": (0.02, _STEEL), "spring": (0.06, _BRASS), "line": (0.005, _STEEL)}


def constraints_of(names: TableReader, table: RobotTable) -> tuple[Constraint, ...]:
    """Holonomic constraints."""
    found = []
    for number, row in enumerate(table.constraints):
        with locate(f"constraint {row.name!r}", UnknownFrame, UnknownJoint):
            found.append(row.make(str(row.name), f"constraint[{number}]", names))
    names.refuse_repetition("constraint", [constraint.name for constraint in found])
    return tuple(found)


def forces_of(names: TableReader, table: RobotTable) -> tuple[QuarticSpring | SpringDamper, ...]:
    """Springs and dampers."""
    springs = (_spring(names, number, row) for number, row in enumerate(table.springs))
    found: list[QuarticSpring | SpringDamper] = list(springs)
    for number, damper in enumerate(table.spring_dampers):
        a, b = names.pair(damper.frames, f"spring_damper[{number}]")
        length = names.distance(a, b) if damper.length is None else damper.length
        name = str(damper.name)
        found.append(SpringDamper(name, a, b, damper.stiffness, damper.damping, length, damper.frames))
    names.refuse_repetition("spring or spring_damper", [force.name for force in found])
    return tuple(found)


def _spring(names: TableReader, number: int, table: QuarticSpringTable) -> QuarticSpring:
    a, b = names.pair(table.frames, f"spring[{number}]")
    length = table.length or names.distance(a, b)
    if table.stiffness is not None and length < _MIN_LENGTH:
        told = "not given, and the frames coincide at the initial pose"
        if table.length is not None:
            told = f"got {length:g} m, expected at least {_MIN_LENGTH:g} m"
        names.refuse(f"spring[{number}].length", told)
    # First paper, section 6.1: V_e = k/(8 l^2) (|d|^2 - l^2)^2
    coefficient = table.coefficient or (table.stiffness or 0.0) / (2.0 * length**2)
    return QuarticSpring(str(table.name), a, b, coefficient, length, table.frames)


def connectors_of(
    names: TableReader,
    table: RobotTable,
    constraints: Iterable[Constraint],
    forces: Iterable[QuarticSpring | SpringDamper],
) -> tuple[Connector, ...]:
    """Connectors in a replay: those of the [[visual]] tables, else a rod or coil for each pair."""
    shown: dict[tuple[int, ...], Connector | None] = {}
    # Frames of other constraints are at one place, or the constraint is visible anyway.
    pairs = [(c.frame_ids, c.connector) for c in constraints if c.connector is not None]
    pairs += [((force.frame_a, force.frame_b), "spring") for force in forces]
    for (a, b), kind in pairs:
        radius, color = _LOOKS[kind]
        shown[_key(a, b)] = Connector(a, b, kind, radius, color)
    for number, row in enumerate(table.visuals):
        a, b = names.pair(row.frames, f"visual[{number}]")
        radius, color = _LOOKS.get(row.type, _LOOKS["line"])
        rgba = color if row.color is None else _rgba(row.color)
        connector = Connector(a, b, row.type, row.radius or radius, rgba)
        shown[_key(a, b)] = None if row.type == "none" else connector
    return tuple(c for c in shown.values() if c is not None)


def spheres_of(names: TableReader, table: RobotTable) -> tuple[CollisionSphere, ...]:
    """Spheres that stand for the shapes of links."""
    for number, row in enumerate(table.collision_spheres):
        with locate(f"{names.file}: collision_sphere[{number}].frame", UnknownFrame):
            names.frame(row.frame)
    return tuple(CollisionSphere(s.frame, s.center, s.radius) for s in table.collision_spheres)


def trace_frames(names: TableReader, table: RobotTable) -> tuple[str, ...]:
    """Frames to trace: those of the table, else the floating base or the tip of the longest chain."""
    if table.trace is not None:
        for name in table.trace:
            names.frame(name)
        return tuple(table.trace)
    floating = joints.joint_kind(names.model, 1).word == "floating"
    depths = [len(support) for support in names.model.supports]
    tip = 1 if floating else int(np.argmax(depths))
    bodies = [f.name for f in names.model.frames if f.parentJoint == tip and f.type == pin.FrameType.BODY]
    return tuple(bodies[:1] if floating else bodies[-1:])


def _rgba(color: Sequence[float]) -> tuple[float, float, float, float]:
    red, green, blue, *opacity = color
    return red, green, blue, opacity[0] if opacity else 1.0


def _key(a: int, b: int) -> tuple[int, ...]:
    return tuple(sorted((a, b)))
