"""`load_parts`: several robots in one world as one `Robot`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pinocchio as pin

from mbocp._files import path_of
from mbocp.exceptions import MbocpError, RobotError
from mbocp.robot import joints
from mbocp.robot.loading.assemble import LossesOf, assemble_robot, losses_of
from mbocp.robot.loading.body import Body, initial_pose, make_body
from mbocp.robot.loading.combine import Part, combined, prefixed, prefixed_frame
from mbocp.robot.loading.elements import Assembly
from mbocp.robot.loading.locking import Lock
from mbocp.robot.loading.part_table import PartTable, part_of
from mbocp.robot.loading.payload_table import payloads_of
from mbocp.robot.loading.sources import Source, find_source
from mbocp.robot.payload import Payload
from mbocp.robot.placed import PlacedRobot
from mbocp.robot.robot import Robot

__all__ = ["load_parts"]


def load_parts(
    parts: Sequence[PartTable | Mapping[str, Any]],
    *,
    lock: Lock | None = None,
    gravity: Sequence[float] | None = None,
    actuated: Sequence[str] | None = None,
    rotations: str | None = None,
    payload: Sequence[Payload | Mapping[str, Any]] = (),
    name: str | None = None,
    base: Path | None = None,
) -> Robot:
    """Load several robots that stand in one world, or on each other, as one.

    Parameters
    ----------
    parts : sequence of mapping
        Tables with ``robot`` (name or path), ``name`` (joints and frames of the part are called
        ``name/...``), ``position`` [m] and ``orientation`` (quaternion xyzw, or roll, pitch, yaw [rad]) of
        its base in the frame ``parent`` ("world" by default), and the options of `load_robot` free_flyer,
        lock, actuated, mimic, damping, friction, friction_speed, package_dirs and payload.
    lock : mapping or sequence of str, optional
        More joints to make rigid, by their names in the whole.
    gravity : sequence of 3 floats, optional
        Acceleration [m/s^2]. Default: what the files of the parts say.
    actuated : sequence of str, optional
        Joints with motors, by their names in the whole, in place of those of the parts.
    rotations : {"quaternion", "dcm"}, optional
        See `load_robot`.
    payload : sequence of Payload or mapping, optional
        Bodies that frames carry, by their names in the whole, beside those of the parts.
    name : str, optional
        What to call the whole. Default: the names of the parts, joined by "+".
    base : Path, optional
        Folder that relative paths start from.

    Returns
    -------
    Robot
        q, v and u have the joints and motors of the parts in their order; those of a part on a moving frame
        follow the joint that moves the frame.

    Raises
    ------
    RobotError
        For a wrong table, parts of the same name, and all that `load_robot` refuses, naming the part.
    """
    tables = [part_of(entry, number) for number, entry in enumerate(parts)]
    if not tables:
        raise RobotError("part: there is none; give at least one table with robot and name")
    _refuse_repeated([table.name for table in tables])
    loaded = [_loaded(table, base) for table in tables]
    title = name or "+".join(table.name for table in tables)
    settled = [key for key, value in (("gravity", gravity), ("rotations", rotations)) if value is not None]
    whole = combined([part for part, _, _, _ in loaded], title, Path("part"), settled)
    locks = {**_by_joint(whole.table.lock), **_by_joint(lock or {})}
    own = tuple(payload for _, _, carried, _ in loaded for payload in carried)
    options = {
        "lock": lock if lock is None or isinstance(lock, Mapping) else list(lock),
        "gravity": None if gravity is None else [float(g) for g in gravity],
        "actuated": None if actuated is None else list(actuated),
        "rotations": rotations,
        "label": name,
    }
    written = {key: value for key, value in options.items() if value is not None}
    return assemble_robot(
        whole,
        lock=locks,
        gravity=gravity,
        actuated=actuated,
        rotations=rotations,
        losses=[losses for _, losses, _, _ in loaded],
        carried=payloads_of([*own, *payload]),
        spec={"part": [spec for _, _, _, spec in loaded], **written},
    )


def _loaded(table: PartTable, base: Path | None) -> tuple[Part, LossesOf, list[Payload], dict[str, Any]]:
    """A part, its losses and payloads in the names of the whole, and the table that loads it again."""
    try:
        source = find_source(table.robot, base)
        dirs = tuple(_absolute(folder, base) for folder in table.package_dirs)
        body = make_body(source, table.free_flyer, table.mimic, dirs)
        joints.check_joints(body.model, body.name)
        part = _part(table, body)
        losses = losses_of(body.table, table.damping, table.friction, table.friction_speed)
        carried = payloads_of(body.table.payloads if table.payload is None else table.payload)
    except MbocpError as error:
        error.args = (f"part {table.name!r}: {error}",)
        raise
    names = frozenset(prefixed(joint, table.name) for joint in joints.joint_names(body.model))
    own = [
        replace(p, name=prefixed(p.name, table.name), frame=prefixed_frame(p.frame, table.name))
        for p in carried
    ]
    spec = _spec(table, source, dirs) | ({"payload": []} if own else {})
    return part, (losses, names), own, spec


def _part(table: PartTable, body: Body) -> Part:
    named = Assembly(
        body.model, (), initial_pose(body), body.table, body.name, body.file, followers=body.followers
    )
    pose = initial_pose(body)
    lock = _by_joint(body.table.lock if table.lock is None else table.lock)
    for joint, value in lock.items():
        number = joints.joint_id(body.model, joint, body.name)
        if value is None:
            lock[joint] = pose[joints.configuration_slice(body.model, number)].tolist()
    placement = table.placement
    placed = PlacedRobot(
        name=table.name,
        robot=body.name,
        parent=table.parent,
        position=tuple(placement.translation.tolist()),
        orientation=tuple(pin.Quaternion(placement.rotation).coeffs().tolist()),
        source=body.urdf,
    )
    trace = named.trace_frames() if body.model.nv else ()
    return Part(body, placed, placement, lock, named.motors(table.actuated), trace)


def _spec(table: PartTable, source: Source, dirs: Sequence[Path]) -> dict[str, Any]:
    """The table with absolute paths; payloads of the whole name themselves."""
    said = table.model_dump(exclude_defaults=True, exclude={"payload"})
    said = {key: list(value) if isinstance(value, tuple) else value for key, value in said.items()}
    folders = {"package_dirs": [str(folder) for folder in dirs]} if dirs else {}
    return {**said, "robot": source.address, **folders}


def _by_joint(lock: Any) -> dict[str, Any]:
    return dict(lock) if isinstance(lock, Mapping) else dict.fromkeys(lock)


def _refuse_repeated(names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise RobotError(f"part: the name {name!r} is given twice; give each part its own")


def _absolute(path: str | Path, base: Path | None) -> Path:
    expanded = path_of(path)
    return (expanded if base is None else base / expanded).resolve()
