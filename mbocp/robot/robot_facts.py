"""What a robot is, as a plain dict for the command line and for JSON, and what is odd in its files."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._text import show
from mbocp.exceptions import MbocpError
from mbocp.robot import joints
from mbocp.robot.drives import name_moved_joints
from mbocp.robot.loading.addresses import absolute
from mbocp.robot.loading.description import Oddity
from mbocp.robot.loading.robot_formats import format_of, reader_of
from mbocp.robot.parts import Drive, QuarticSpring
from mbocp.robot.resistance import ElasticJoint, JointResistance
from mbocp.robot.robot import Robot

_MAX_ALIKE = 4  # joints of which the same is said, named in one line


def describe(robot: Robot) -> dict[str, Any]:
    """Everything a person may want to know about a robot, JSON-able; a limit that is not there is None.

    Returns
    -------
    dict
        name, description, source, format (of the source), dimensions (nq, nv, nu, nc), dofs and mobility
        (degrees of freedom that the constraints leave), mass [kg], inertias (of links whose file gives none),
        gravity [m/s^2], joints, actuators, actuated (their names), passive (joints that none of them acts
        upon directly), drives, speeds, constraints, forces, elastic (joints), payloads, parts, frames,
        trace_frames, q0 [rad, m], rotations, fingerprint. Drives are among the actuators, last.
    """
    return {
        "name": robot.name,
        "description": robot.description,
        "source": None if robot.source is None else str(robot.source),
        "format": None if robot.source is None else format_of(robot.source).name,
        "nq": robot.nq,
        "nv": robot.nv,
        "nu": robot.nu,
        "nc": robot.nc,
        "dofs": robot.nv - robot.nc,
        "mobility": robot.nv - robot.nc,
        "mass": float(sum(inertia.mass for inertia in list(robot.model.inertias)[1:])),
        "inertias": [{"link": one.link, **one.table, "origin": one.origin} for one in robot.link_inertias],
        "gravity": [float(g) for g in robot.model.gravity.linear],
        "joints": [_joint(robot, j) for j in range(1, robot.model.njoints)],
        "actuators": [
            {"name": label.name, "unit": label.unit, "limit": _finite(limit)}
            | ({} if least == -limit else {"least": _finite(least)})
            for label, limit, least in zip(
                robot.u_labels, robot.limits.effort, robot.limits.effort_lower, strict=True
            )
        ],
        "actuated": [label.name for label in robot.u_labels],
        "passive": _passive(robot),
        "drives": [_drive(robot, drive) for drive in robot.drives],
        "speeds": [{"name": label.name, "unit": label.unit} for label in robot.speed_labels],
        "constraints": [_constraint(robot, number) for number in range(len(robot.constraints))],
        "forces": [_force(force) for force in robot.forces],
        "elastic": [_elastic(robot, joint) for joint in robot.elastic],
        "payloads": [payload.table for payload in robot.payloads],
        "parts": [part.table for part in robot.parts],
        "frames": list(robot.frame_names),
        "trace_frames": list(robot.trace_frames),
        "q0": robot.q0.tolist(),
        "rotations": robot.rotations,
        "fingerprint": robot.fingerprint,
    }


def find_oddities(robot: Robot, q_start: Array | None = None, *, key: str = "") -> tuple[str, ...]:
    """Find what is allowed in the files of a robot, and probably not meant; one line for each.

    Nothing is said of links that have other inertias, of joints that are locked or follow a leader, and of
    motors where there are none.

    Parameters
    ----------
    robot : Robot
    q_start : ndarray, shape (nq,), optional
        Start of a problem [m, rad]: where it is within limits, nothing is said of where poses begin.
    key : str, optional
        Key of problem files: only of what it says otherwise.
    """
    found = list[Oddity]()
    parts = ("", *(part.prefix for part in robot.parts))
    moving = {name.removeprefix(part) for name in robot.joint_names for part in parts}
    fixed = [frame.name for frame in robot.model.frames if frame.type == pin.FrameType.FIXED_JOINT]
    follow = [robot.model.names[joint] for joint in robot.model.mimicking_joints]
    still = {name.removeprefix(part) for name in fixed for part in parts} - moving
    still |= {name.removeprefix(part) for name in follow for part in parts}
    mended = {one.link.removeprefix(part) for one in robot.link_inertias for part in parts}
    outside = {name.removeprefix(part) for name in _outside(robot, q_start) for part in parts}
    folders = [absolute(folder, None) for folder in robot.spec.get("package_dirs", ())]
    for path in robot.sources:
        try:
            read = reader_of(path, folders, robot.spec.get("arguments")).oddities(path)
            found += [one for one in read if one.link not in mended and one.joint not in still]
        except MbocpError:  # the file has changed, or is no longer there
            continue
    found = [one for one in found if one.key != "start.q" or one.joint in outside]
    idle = _passive(robot)
    driven = {name.removeprefix(part) for name in robot.joint_names if name not in idle for part in parts}
    found = [one for one in found if one.key != "robot.actuated" or one.joint in driven]
    return tuple(_join_alike(one for one in found if key in ("", one.key)))


def _outside(robot: Robot, q: Array | None) -> list[str]:
    """Joints that are not within their limits, or of which no pose is given."""
    lower, upper = robot.limits.position_lower, robot.limits.position_upper
    is_within = np.zeros(robot.nq, dtype=np.bool_) if q is None else (lower <= q) & (q <= upper)
    return [name for name in robot.joint_names if not is_within[robot.configuration_indices(name)].all()]


def _join_alike(found: Iterable[Oddity]) -> Iterator[str]:
    """Say in one line what is said of several joints."""
    alike: dict[str, list[str]] = {}
    for one in dict.fromkeys(found):
        if one.joint:
            alike.setdefault(one.words, []).append(show(one.joint))
        else:
            yield f"link {show(one.link)}: {one.words}" if one.link else one.words
    for words, names in alike.items():
        more = f" and {len(names) - _MAX_ALIKE} more" if len(names) > _MAX_ALIKE else ""
        yield f"joint{'s' if len(names) > 1 else ''} {', '.join(names[:_MAX_ALIKE])}{more}: {words}"


def _joint(robot: Robot, joint: int) -> dict[str, Any]:
    q, v = joints.configuration_slice(robot.model, joint), joints.velocity_slice(robot.model, joint)
    kind = joints.joint_kind(robot.model, joint)
    limits = robot.limits
    losses = [r for r in robot.resistances if r.name == robot.model.names[joint]]
    return {
        "name": robot.model.names[joint],
        "type": kind.word,
        "nq": len(kind.q),
        "nv": len(kind.v),
        "actuated": bool(np.any(robot.actuation.selection[v])),
        "driven": any(v.start <= dof < v.stop for dof in robot.driven),
        "lower": [_finite(x) for x in limits.position_lower[q]],
        "upper": [_finite(x) for x in limits.position_upper[q]],
        "velocity": [_finite(x) for x in limits.velocity[v]],
        "damping": _largest(losses, "damping"),
        "friction": _largest(losses, "friction"),
        "units": [label.unit for label in robot.q_labels[q]],
    }


def _largest(losses: Sequence[JointResistance], name: str) -> float:
    """Of the joint's directions: those of a ball joint resist alike."""
    return max(
        (float(sum(getattr(r, name) for r in losses if r.dof == dof)) for dof in {r.dof for r in losses}),
        default=0.0,
    )


def _drive(robot: Robot, drive: Drive) -> dict[str, Any]:
    frame = None if drive.frame_id is None else robot.frame_names[drive.frame_id]
    direction = None if frame is None else drive.direction.tolist()
    return {
        "name": drive.name,
        "control": drive.control,
        "unit": drive.unit,
        "joints": name_moved_joints(robot, drive.dofs),
        "frame": frame,
        "direction": direction,
    }


def _passive(robot: Robot) -> list[str]:
    """Joints without a motor or drive; wrenches and thrusters act on bodies."""
    idle = ~np.any(robot.actuation.selection, axis=1)
    idle[list(robot.driven)] = False
    slices = ((name, robot.velocity_indices(name)) for name in robot.joint_names)
    return [name for name, where in slices if where.stop > where.start and idle[where].all()]


def _constraint(robot: Robot, number: int) -> dict[str, Any]:
    constraint, places = robot.constraints[number], robot.constraint_rows[number]
    rows = [label.name for label in constraint.rows]
    redundant = [name for name, place in zip(rows, places, strict=True) if place in robot.redundant_rows]
    facts = {"name": constraint.name, "type": constraint.kind, **constraint.facts}
    return {**facts, "rows": rows, "redundant_rows": redundant}


def _force(force: Any) -> dict[str, Any]:
    common = {"name": force.name, "type": force.kind, "frames": list(force.frames), "length": force.length}
    if isinstance(force, QuarticSpring):
        return {**common, "coefficient": force.coefficient}
    return {**common, "stiffness": force.stiffness, "damping": force.damping}


def _elastic(robot: Robot, joint: ElasticJoint) -> dict[str, Any]:
    rotor = float(robot.model.armature[joint.at_v[1]])
    numbers = {"stiffness": joint.stiffness, "damping": joint.damping, "motor_inertia": rotor}
    return {"name": joint.name, "type": "elastic", "joints": [joint.name, joint.motor], **numbers}


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
