"""From a source or tables of parts to a body, what acts on its joints, and what it carries.

A robot.toml may assemble parts, which may be such files in turn: hence one module reads both.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pinocchio as pin

from mbocp._files import path_of
from mbocp.exceptions import MbocpError, RobotError, RobotFileError
from mbocp.robot import joints
from mbocp.robot.loading.assemble import LossesOf, losses_of
from mbocp.robot.loading.body import Body, initial_pose, make_body, object_body
from mbocp.robot.loading.combine import Part, combined, prefixed, prefixed_frame
from mbocp.robot.loading.elements import Assembly
from mbocp.robot.loading.part_table import PartTable
from mbocp.robot.loading.payload_table import payloads_of
from mbocp.robot.loading.schema import RobotTable, read_robot_toml
from mbocp.robot.loading.sources import Source, find_source
from mbocp.robot.loading.whole_table import by_joint, with_own_tables
from mbocp.robot.payload import Payload
from mbocp.robot.placed import PlacedRobot


@dataclass(frozen=True, eq=False)
class Options:
    """Options of `load_robot` that say how a source is read; None where they say nothing."""

    free_flyer: bool | None = None
    mimic: bool | None = None
    damping: bool | None = None
    friction: str | None = None
    friction_speed: float | None = None
    payload: Sequence[Any] | None = None
    package_dirs: tuple[Path, ...] = ()


@dataclass(frozen=True, eq=False)
class Whole:
    """A body before its joints are locked, and what belongs to it.

    Parameters
    ----------
    body : Body
    losses : tuple of LossesOf
        Damping and friction that act, in its names.
    carried : tuple of Payload
        In its names.
    specs : tuple of dict
        Tables that load its parts again, with absolute paths.
    """

    body: Body
    losses: tuple[LossesOf, ...]
    carried: tuple[Payload, ...]
    specs: tuple[dict[str, Any], ...] = ()


def whole_from_source(source: Source, options: Options, within: tuple[Path, ...] = ()) -> Whole:
    """Read a source.

    Parameters
    ----------
    source : Source
    options : Options
    within : tuple of Path
        Files that assemble this one, the outermost first.

    Raises
    ------
    RobotFileError
        If a file assembles itself, and for what is wrong in it.
    RobotError
        For options that belong into the parts.
    """
    table = read_robot_toml(source.path) if source.kind == "toml" else RobotTable.model_construct()
    if table.parts:
        return _assembled(source, table, options, within)
    body = make_body(source, options.free_flyer, options.mimic, options.package_dirs)
    losses = losses_of(body.table, options.damping, options.friction, options.friction_speed)
    carried = payloads_of(body.table.payloads if options.payload is None else options.payload)
    return Whole(body, ((losses, None),), carried)


def _assembled(source: Source, table: RobotTable, options: Options, within: tuple[Path, ...]) -> Whole:
    """The whole that a robot.toml with parts describes."""
    if source.path in within:
        circle = " -> ".join(str(path) for path in (*within[within.index(source.path) :], source.path))
        raise RobotFileError(source.path, f"assembles itself: {circle}", "part")
    for key in ("free_flyer", "mimic", "damping", "friction", "friction_speed"):
        if getattr(options, key) is not None:
            raise RobotError(
                f"{key}: robot {source.name!r} is assembled of parts; write it into each [[part]] of "
                f"{source.path}"
            )
    settled = [key for key in ("gravity", "rotations") if getattr(table, key) is not None]
    name = table.name or source.name
    folder, dirs = source.path.parent, options.package_dirs
    inner = (*within, source.path)
    try:
        whole = whole_of(
            table.parts, table, name, source.path, settled=settled, base=folder, dirs=dirs, within=inner
        )
    except RobotFileError:
        raise
    except RobotError as error:
        error.args = (f"{source.path}: {error}",)
        raise
    own = [*whole.carried, *payloads_of(table.payloads)]
    carried = own if options.payload is None else payloads_of(options.payload)
    return replace(whole, carried=tuple(carried), specs=())


def whole_of(
    parts: Sequence[PartTable],
    own: RobotTable,
    name: str,
    file: Path,
    *,
    settled: Collection[str] = (),
    base: Path | None = None,
    dirs: tuple[Path, ...] = (),
    within: tuple[Path, ...] = (),
) -> Whole:
    """Put parts together, with the tables that stand beside them.

    Parameters
    ----------
    parts : sequence of PartTable
    own : RobotTable
        Tables in the names of the whole: what joins the parts, initial pose, motors.
    name : str
        What to call the whole.
    file : Path
        Where the tables stand, for messages.
    settled : collection of str
        Which of gravity and rotations is said beside the parts.
    base : Path, optional
        Folder that relative paths start from.
    dirs : tuple of Path
        More folders with packages.
    within : tuple of Path
        Files that assemble these parts, the outermost first.

    Raises
    ------
    RobotError
        For parts of the same name, and for what is wrong with one of them, naming it.
    """
    _refuse_repeated([table.name for table in parts])
    loaded = [_part(table, base, dirs, within) for table in parts]
    body = with_own_tables(combined([part for part, _ in loaded], name, file, settled), own)
    return Whole(
        body,
        losses=tuple(losses for _, whole in loaded for losses in whole.losses),
        carried=tuple(payload for _, whole in loaded for payload in whole.carried),
        specs=tuple(spec for _, whole in loaded for spec in whole.specs),
    )


def _part(
    table: PartTable, base: Path | None, dirs: tuple[Path, ...], within: tuple[Path, ...]
) -> tuple[Part, Whole]:
    """A part, and what belongs to it in the names of the whole."""
    try:
        whole, address = _read(table, base, dirs, within)
        joints.check_joints(whole.body.model, whole.body.name)
        part = _placed(table, whole.body)
    except MbocpError as error:
        error.args = (f"part {table.name!r}: {error}",)
        raise
    own = tuple(
        replace(p, name=prefixed(p.name, table.name), frame=prefixed_frame(p.frame, table.name))
        for p in whole.carried
    )
    all_joints = joints.joint_names(whole.body.model)
    losses = tuple(
        (acting, frozenset(prefixed(joint, table.name) for joint in (names or all_joints)))
        for acting, names in whole.losses
    )
    names_payloads = bool(own) or table.payload is not None
    spec = _spec(table, address, base) | ({"payload": []} if names_payloads else {})
    return part, Whole(whole.body, losses, own, (spec,))


def _read(
    table: PartTable, base: Path | None, dirs: tuple[Path, ...], within: tuple[Path, ...]
) -> tuple[Whole, str | None]:
    """What the table names or describes, and the address that leads there again."""
    if table.robot is None:
        body = object_body(table.name, table.shape, free_flyer=table.free_flyer is not False)
        return Whole(body, (), ()), None
    source = find_source(table.robot, base)
    own = tuple(_absolute(folder, base) for folder in table.package_dirs)
    options = Options(
        table.free_flyer,
        table.mimic,
        table.damping,
        table.friction,
        table.friction_speed,
        table.payload,
        (*own, *dirs),
    )
    return whole_from_source(source, options, within), source.address


def _placed(table: PartTable, body: Body) -> Part:
    pose = initial_pose(body)
    named = Assembly(body.model, (), pose, body.table, body.name, body.file, followers=body.followers)
    lock = by_joint(body.table.lock if table.lock is None else table.lock)
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
        is_object=table.is_object,
    )
    body = replace(body, named_locks=body.named_locks | set(table.lock or ()))
    trace = named.trace_frames() if body.model.nv else ()
    return Part(body, placed, placement, lock, named.motors(table.actuated), trace, table.is_object)


def _spec(table: PartTable, address: str | None, base: Path | None) -> dict[str, Any]:
    """The table with absolute paths; payloads of the whole name themselves."""
    said = table.model_dump(exclude_defaults=True, exclude={"payload"})
    said = {key: list(value) if isinstance(value, tuple) else value for key, value in said.items()}
    folders = [str(_absolute(folder, base)) for folder in table.package_dirs]
    named = {"robot": address} if address is not None else {}
    return {**said, **named, **({"package_dirs": folders} if folders else {})}


def _refuse_repeated(names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise RobotError(f"part: the name {name!r} is given twice; give each part its own")


def _absolute(path: str | Path, base: Path | None) -> Path:
    expanded = path_of(path)
    return (expanded if base is None else base / expanded).resolve()
