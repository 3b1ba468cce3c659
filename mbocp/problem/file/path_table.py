"""`[[path]]`: its keys, from what is written, also points in files, to constraints, and back."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._files import MEGABYTE, is_file, path_of, read_bytes, read_text
from mbocp._keys import Key, Table
from mbocp._measured import in_unit
from mbocp._merged import merge_tables
from mbocp._text import reads_as_number, show
from mbocp.exceptions import ProblemError, Unreadable, locate
from mbocp.problem._checks import check_choice, choice
from mbocp.problem.contact_bounds import ContactBounds
from mbocp.problem.contact_force import ContactForce
from mbocp.problem.goals.goal import Goal
from mbocp.problem.path import PathConstraint
from mbocp.robot import Robot
from mbocp.robot.kinematics import WORLD
from mbocp.terms.contact import ContactTerm
from mbocp.terms.heights import SurfaceKeys, surface_from
from mbocp.terms.kinds import PATH_KEYS, PATH_TERMS
from mbocp.terms.span import SPAN, Span, SpanKeys

_HEAD = ("name", "kind", "frame", "profile", *SPAN)
_MAX_BYTES = 16 * MEGABYTE
_COLUMNS = "x, y, z, or x, y, z, qx, qy, qz, qw"


class PathHead(Table):
    """Keys that every path constraint has."""

    name: Annotated[str | None, Key("its name", "", "kind and frame")] = None
    kind: Annotated[str, choice(PATH_KEYS), Key("what is constrained")]
    frame: Annotated[
        str | None,
        Key("frame of the robot", "", "required, but for forces and all of the robot"),
    ] = None
    profile: Annotated[str | None, Key("that it is of, in results")] = None


PathTable = merge_tables(
    "PathTable",
    "One constraint on a frame or a force that holds along the motion: the keys of all kinds.",
    (*PATH_KEYS.values(), SpanKeys),
    PathHead,
)


def path_from(
    robot: Robot, tables: Iterable[tuple[str, PathHead]], q_start: Array, goal: Goal, folder: Path
) -> tuple[PathConstraint | ContactForce, ...]:
    """Make the constraints from keys and tables; files that they name are relative to a folder.

    Raises
    ------
    ProblemError, UnknownFrame, InvalidValue
        If a frame is unknown, or keys do not fit the kind.
    """
    found = []
    for key, table in tables:
        with locate(key):
            found.append(_constraint(robot, table, key, q_start, goal, folder))
    return tuple(found)


def path_tables(robot: Robot, path: Sequence[object]) -> list[dict[str, Any]]:
    """Return the tables that read back as `path`; others are written elsewhere."""
    found = []
    for constraint in path:
        if isinstance(constraint, PathConstraint):
            found.append(_table(robot, constraint))
        elif isinstance(constraint, ContactBounds):
            found.append(constraint.contact.write())
    return found


def _constraint(
    robot: Robot, table: PathHead, key: str, q_start: Array, goal: Goal, folder: Path
) -> PathConstraint | ContactForce:
    kind = check_choice(f"{key}.kind", table.kind, PATH_KEYS)
    given = _keys_of_kind(table, kind, key)
    if kind == ContactTerm.kind:
        return _contact(table, key, given)
    term = PATH_TERMS[kind]
    if table.frame is None and not term.of_robot:
        raise ProblemError(f'{key}.frame: this key is missing; kind = "{kind}" is about a frame')
    if table.frame is not None and term.of_robot:
        raise ProblemError(f'{key}.frame: kind = "{kind}" does not use it; it is about all of the robot')
    if "file" in given:
        if "points" in given:
            raise ProblemError(f"{key}: points and file; which of the two? Give one")
        given |= read_points(folder / path_of(given.pop("file")), f"{key}.file")
    name = WORLD if table.frame is None else table.frame
    frame = robot.frame_id(name)
    if term.of_joint and not _has_angle(robot, frame):
        raise ProblemError(f'{key}.frame: {name!r} is no joint with one angle; kind = "{kind}" is of one')
    if term.of_motor:
        _check_motor(robot, name, key)
    start = robot.frame_placement(name, q_start)
    values = term.read(term.complete(given, start, _goal_position(robot, name, goal), key), robot, key)
    known = PathConstraint.__dataclass_fields__
    return PathConstraint(
        name=table.name or (f"{kind} of {name}" if table.frame else kind),
        kind=kind,
        frame=frame,
        profile=table.profile,
        span=Span.read(table),
        further={name: value for name, value in values.items() if name not in known},
        **{name: value for name, value in values.items() if name in known},
    )


def _has_angle(robot: Robot, frame: int) -> bool:
    """Whether a frame is that of a joint with one angle."""
    found = robot.model.frames[frame]
    joint = robot.model.joints[found.parentJoint]
    is_angle = joint.nq == joint.nv == 1 and robot.v_labels[joint.idx_v].unit == "rad/s"
    return bool(found.type == pin.FrameType.JOINT and is_angle)


def _check_motor(robot: Robot, joint: str, key: str) -> None:
    """Refuse a joint that no torque of its own turns: a row of its motor would hold whatever that does."""
    for elastic in robot.elastic:
        if elastic.name == joint:
            raise ProblemError(f"{key}.frame: joint {joint!r} is elastic; name its motor, {elastic.motor!r}")
    turned = robot.actuation.selection[robot.velocity_indices(joint).start]
    if not any(column and robot.u_labels[k].unit == "N m" for k, column in enumerate(turned)):
        raise ProblemError(f"{key}.frame: no motor turns joint {joint!r} by a torque")


def _keys_of_kind(table: PathHead, kind: str, key: str) -> dict[str, Any]:
    """Values of the keys that are written, of which the kind has to know each."""
    written = {name: getattr(table, name) for name in type(table).model_fields if name not in _HEAD}
    given = {name: value for name, value in written.items() if value is not None}
    for name in given:
        if name not in PATH_KEYS[kind].model_fields:
            used = ", ".join(PATH_KEYS[kind].model_fields)
            raise ProblemError(f'{key}.{name}: kind = "{kind}" does not use it, but {used}')
    unit = "" if kind == ContactTerm.kind else PATH_TERMS[kind].unit
    fields = PATH_KEYS[kind].model_fields
    return {
        name: in_unit(value, fields[name].metadata, unit, f"{key}.{name}") for name, value in given.items()
    }


def _contact(table: PathHead, key: str, given: dict[str, Any]) -> ContactForce:
    """A bound on the force of a constraint."""
    if table.frame is not None:
        raise ProblemError(
            f'{key}.frame: kind = "{ContactTerm.kind}" does not use it; name the constraint that holds it'
        )
    if "constraint" not in given:
        raise ProblemError(f"{key}.constraint: this key is missing: the constraint whose force is bounded")
    name = table.name or f"{ContactTerm.kind} of {given['constraint']}"
    surface = surface_from(given, key)
    words = {name: value for name, value in given.items() if name not in SurfaceKeys.model_fields}
    lists = {name: tuple(value) for name, value in words.items() if isinstance(value, list)}
    return ContactForce(name=name, span=Span.read(table), surface=surface, **(words | lists))


def _goal_position(robot: Robot, frame: str, goal: Goal) -> Array | None:
    """Where the goal says that a frame is, shape (3,) [m]; None where it does not."""
    for of_frame in goal.frames:
        position = of_frame.target.position
        if of_frame.name == frame and of_frame.target.relative_to == WORLD and position is not None:
            return position if np.isfinite(position).all() else None
    return robot.frame_placement(frame, goal.q).translation if goal.q_active.all() else None


def _table(robot: Robot, constraint: PathConstraint) -> dict[str, Any]:
    term = PATH_TERMS[constraint.kind]
    return {
        "name": constraint.name,
        "kind": constraint.kind,
        **({} if term.of_robot else {"frame": robot.frame_names[constraint.frame]}),
        **term.write(constraint, robot),
        **constraint.span.write(),
        **({} if constraint.profile is None else {"profile": constraint.profile}),
    }


def read_points(path: Path, key: str) -> dict[str, Any]:
    """Keys `points` and perhaps `orientations` of a path that is followed.

    Parameters
    ----------
    path : Path
        A CSV table, with or without a row of names, or an array of NumPy's format .npy.
    key : str
        What messages call it.

    Raises
    ------
    ProblemError
        If there is no such file, or it holds no table of three or seven columns.
    """
    if not is_file(path):
        raise ProblemError(f"{key}: no such file {show(str(path))}")
    try:
        table = _read_array(path) if path.suffix.lower() == ".npy" else _read_csv(path)
    except Unreadable as error:
        raise ProblemError(f"{key}: {path} {error.reason}") from error
    except (ValueError, csv.Error) as error:
        raise ProblemError(f"{key}: {path} holds no table of numbers ({error})") from error
    if table.ndim != 2 or table.shape[1] not in (3, 7):
        raise ProblemError(f"{key}: {path} is of shape {table.shape}, expected columns {_COLUMNS}")
    turns = {"orientations": table[:, 3:].tolist()} if table.shape[1] == 7 else {}
    return {"points": table[:, :3].tolist(), **turns}


def _read_csv(path: Path) -> Array:
    rows = [
        row
        for row in csv.reader(read_text(path, expected="a CSV table", limit=_MAX_BYTES).splitlines())
        if row
    ]
    if rows and not reads_as_number(rows[0][0]):
        rows = rows[1:]
    return np.array([[float(entry) for entry in row] for row in rows])


def _read_array(path: Path) -> Array:
    read = read_bytes(path, expected="an array of NumPy", limit=_MAX_BYTES)
    return np.asarray(np.load(io.BytesIO(read), allow_pickle=False), dtype=np.float64)
