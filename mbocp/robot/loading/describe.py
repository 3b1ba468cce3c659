"""From a source, or tables of parts, to the description of a robot.

A robot.toml may assemble parts, which may be such files in turn: hence one module reads both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pinocchio as pin

from mbocp._text import find_repeated
from mbocp.exceptions import RobotError, RobotFileError, locate
from mbocp.robot import joints
from mbocp.robot.loading.actuation import ActuationReader
from mbocp.robot.loading.addresses import find_root_of_stored, resolve
from mbocp.robot.loading.combine import combine
from mbocp.robot.loading.description import Description, ReadOptions
from mbocp.robot.loading.elements import trace_frames
from mbocp.robot.loading.joint_numbers import Losses
from mbocp.robot.loading.locking import by_joint
from mbocp.robot.loading.model_changes import make_spherical, without_dynamics
from mbocp.robot.loading.readers import example_robots
from mbocp.robot.loading.readers.in_memory import describe_chain, describe_object
from mbocp.robot.loading.robot_formats import reader_of
from mbocp.robot.loading.robot_keys import OF_FILES, PartTable, ReadingKeys
from mbocp.robot.loading.robot_sources import Source, find_source
from mbocp.robot.loading.robot_tables import InertiasTable, payloads_of
from mbocp.robot.loading.robot_toml import ActuationTable, RobotTable, read_robot_toml
from mbocp.robot.loading.table_types import TableReader
from mbocp.robot.loading.whole_table import RobotPart, with_own_tables
from mbocp.robot.placed import SEPARATOR, PlacedRobot
from mbocp.robot.resistance import FRICTION_SPEED


def describe_source(
    source: Source, keys: ReadingKeys, folders: Sequence[Path], within: tuple[Path, ...] = ()
) -> Description:
    """Read a source.

    Parameters
    ----------
    source : Source
    keys : ReadingKeys
        What they say takes precedence over what the file says.
    folders : sequence of Path
        That hold packages of meshes.
    within : tuple of Path
        Files that assemble this one, the outermost first.

    Raises
    ------
    RobotFileError
        If a file assembles itself, and for what is wrong in it.
    RobotError
        For options that belong into the parts.
    """
    table = read_robot_toml(source.path) if source.kind == "toml" else None
    if table is not None and table.parts:
        return _describe_parts(source, table, keys, folders, within)
    if keys.arguments and not source.is_file:
        raise RobotError(f"arguments: robot {source.name!r} takes none; only xacro files do")
    has_dynamics, inertias = _masses(table, keys)
    how = ReadOptions(keys.free_flyer, keys.mimic, (*folders, *source.package_dirs), inertias)
    if table is not None:
        found = _with_table(source, table, keys, how)
    elif source.kind == "chain":
        if inertias is not None:
            raise RobotError(f"inertias: robot {source.name!r} has its own; only files may be without")
        found = describe_chain(source.name, free_flyer=bool(how.free_flyer))
    elif source.kind == "example":
        found = example_robots.describe_example(source.name, source.example, how)
    else:
        found = reader_of(source.path, how.folders, keys.arguments).read(source.path, source.name, how)
    given = found.table.payloads if keys.payload is None else keys.payload
    losses = (_losses(found.table, keys),)
    found = replace(_with_ball_joints(found), losses=losses, carried=payloads_of(given))
    return found if has_dynamics else without_dynamics(found)


def _masses(table: RobotTable | None, keys: ReadingKeys) -> tuple[bool, InertiasTable | None]:
    """Whether forces move the robot, and where masses come from; options take precedence over robot.toml."""
    own = keys if table is None else table
    if (own.dynamics if keys.dynamics is None else keys.dynamics) is not False:
        return True, own.inertias if keys.inertias is None else keys.inertias
    if keys.inertias is not None or (keys.dynamics is None and own.inertias is not None):
        raise RobotError("inertias: has no meaning with dynamics = false; leave one of the two out")
    return False, None


def _with_table(source: Source, table: RobotTable, keys: ReadingKeys, how: ReadOptions) -> Description:
    """The model that a robot.toml names, with its tables."""
    path, folders = model_file(source.path, table, how.folders)
    arguments = {**(table.arguments or {}), **(keys.arguments or {})}
    name, reader = table.name or source.name, reader_of(path, folders, arguments)
    free_flyer = table.free_flyer if how.free_flyer is None else how.free_flyer
    mimic = table.mimic if how.mimic is None else how.mimic
    found = reader.read(path, name, ReadOptions(free_flyer, mimic, folders, how.inertias))
    return replace(found, name=name, table=_add(found.table, table), file=source.path)


def _add(own: RobotTable, table: RobotTable) -> RobotTable:
    """What a robot.toml says, on what its file says; loops are those of both."""
    said = {key: getattr(table, key) for key in table.model_fields_set}
    loops = [*own.constraints, *table.constraints]
    return own.model_copy(update={**said, "constraints": loops})


def model_file(path: Path, table: RobotTable, folders: Sequence[Path]) -> tuple[Path, tuple[Path, ...]]:
    """Find the file that a robot.toml adds to, and all folders with its packages.

    Raises
    ------
    RobotFileError
        If it does not exist.
    UnsupportedRobot
        If it is the name of a robot that example-robot-data builds by code, or that is no URDF.
    """
    folders = (*folders, *(path.parent / folder for folder in table.package_dirs))
    if table.urdf in example_robots.names() and find_root_of_stored(path.parent) is None:
        facts = example_robots.example_facts(table.urdf)
        return facts.path, (*folders, *facts.packages)
    try:
        return resolve(table.urdf, path.parent, folders), folders
    except FileNotFoundError as error:
        raise RobotFileError(path, str(error), "urdf") from error


def _with_ball_joints(found: Description) -> Description:
    if not found.table.spherical:
        return found
    model = make_spherical(found.model, found.table.spherical, found.name)
    return replace(found, model=model, q0=pin.neutral(model))


def _losses(table: RobotTable, keys: ReadingKeys) -> Losses:
    """Losses: options take precedence over robot.toml, and robot.toml over defaults."""
    said = ((keys.damping, table.damping, True), (keys.friction_speed, table.friction_speed, FRICTION_SPEED))
    acts, scale = (next(value for value in values if value is not None) for values in said)
    return Losses(bool(acts), table.friction if keys.friction is None else keys.friction, float(scale))


def _describe_parts(
    source: Source, table: RobotTable, keys: ReadingKeys, folders: Sequence[Path], within: tuple[Path, ...]
) -> Description:
    """The whole that a robot.toml with parts describes."""
    if source.path in within:
        circle = " -> ".join(str(path) for path in (*within[within.index(source.path) :], source.path))
        raise RobotFileError(source.path, f"assembles itself: {circle}", "part")
    given = keys.inertias if keys.inertias is not None and keys.inertias.is_whole else None
    for key in OF_FILES:
        if getattr(keys, key) not in (None, given):
            raise RobotError(
                f"{key}: robot {source.name!r} is assembled of parts; write it into each [[part]] of "
                f"{source.path}"
            )
    name, inner = table.name or source.name, (*within, source.path)
    try:
        parts = read_parts(_with_numbers(table.parts, given), source.path.parent, folders, inner)
        found = describe_parts(parts, table, name, source.path)
    except RobotFileError:
        raise
    except RobotError as error:
        error.put_into(source.path)
        raise
    own = (*found.carried, *payloads_of(table.payloads))
    return replace(found, carried=own if keys.payload is None else payloads_of(keys.payload))


def _with_numbers(tables: Sequence[PartTable], given: InertiasTable | None) -> Sequence[PartTable]:
    """Tables of parts with their share of the numbers of a robot that is loaded again."""
    if given is None:
        return tables
    shares = [given.within(table.name + SEPARATOR) for table in tables]
    if sum(len(share.links) for share in shares) < len(given.links):
        names = ", ".join(repr(table.name) for table in tables)
        raise RobotError(
            f"inertias.links: expected PART/LINK, with a part {names}; got {', '.join(given.links)}"
        )
    return [
        table.model_copy(update={"inertias": share} if share.links else {})
        for table, share in zip(tables, shares, strict=True)
    ]


def describe_parts(parts: Sequence[RobotPart], own: RobotTable, name: str, file: Path) -> Description:
    """Put parts together, with the tables that stand beside them.

    Parameters
    ----------
    parts : sequence of RobotPart
    own : RobotTable
        Tables in the names of the whole: what joins the parts, initial pose, motors.
    name : str
        What to call the whole.
    file : Path
        Where the tables stand, for messages.

    Raises
    ------
    RobotError
        For what is wrong with one of them, naming it.
    """
    settled = [key for key in ("gravity", "rotations") if getattr(own, key) is not None]
    return with_own_tables(combine(parts, name, file, settled), own)


def read_parts(
    tables: Sequence[PartTable],
    base: Path | None,
    folders: Sequence[Path] = (),
    within: tuple[Path, ...] = (),
) -> list[RobotPart]:
    """Read what tables of parts name or describe.

    Parameters
    ----------
    tables : sequence of PartTable
    base : Path, optional
        Folder that relative paths start from.
    folders : sequence of Path
        More folders with packages.
    within : tuple of Path
        Files that assemble these parts, the outermost first.

    Raises
    ------
    RobotError
        For parts of the same name, and for what is wrong with one of them, naming it.
    """
    if repeated := find_repeated(table.name for table in tables):
        raise RobotError(f"part: the name {repeated[0]!r} is given twice; give each part its own")
    return [_part(table, base, folders, within) for table in tables]


def _part(
    table: PartTable, base: Path | None, folders: Sequence[Path], within: tuple[Path, ...]
) -> RobotPart:
    with locate(f"part {table.name!r}"):
        if table.robot is None:
            found = describe_object(table.name, table.shape, free_flyer=table.free_flyer is not False)
            spec = table.portable(base)
        else:
            source = find_source(table.robot, base)
            found = describe_source(source, table, (*table.folders(base), *folders), within)
            spec = {**table.portable(base), "robot": source.address, **inertias_of(found)}
        joints.check_joints(found.model, found.name)
        described, placed = _with_options(found, table), _place(table, found)
    names_payloads = found.carried or table.payload is not None
    return RobotPart(
        described, placed, table.placement, {**spec, **({"payload": []} if names_payloads else {})}
    )


def inertias_of(found: Description) -> dict[str, Any]:
    """The masses and inertias of links as numbers, which need no shapes when the robot is loaded again."""
    links = {one.link: one.table for one in found.link_inertias}
    return {"inertias": {"links": links}} if links else {}


def _with_options(found: Description, keys: PartTable) -> Description:
    """Say in the tables of a part what its options make of it: locked joints, motors, frames to trace."""
    pose, table = found.pose, found.table
    names = TableReader(found.model, (), found.name, found.file, pose)
    lock = by_joint(table.lock if keys.lock is None else keys.lock)
    for joint, value in lock.items():
        number = joints.joint_id(found.model, joint, found.name)
        if value is None:
            lock[joint] = pose[joints.configuration_slice(found.model, number)].tolist()
    said = {
        "lock": lock,
        "trace": trace_frames(names, table) if found.model.nv else (),
        "actuation": ActuationTable(joints=ActuationReader(names, table).motors(keys.actuated)),
    }
    locks = found.named_locks | set(keys.lock or ())
    return replace(found, table=table.model_copy(update=said), named_locks=locks)


def _place(table: PartTable, found: Description) -> PlacedRobot:
    placement = table.placement
    return PlacedRobot(
        name=table.name,
        robot=found.name,
        parent=table.parent,
        position=tuple(placement.translation.tolist()),
        orientation=tuple(pin.Quaternion(placement.rotation).coeffs().tolist()),
        source=found.source,
        is_object=table.robot is None,
    )
