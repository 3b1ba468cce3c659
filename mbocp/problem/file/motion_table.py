"""`obstacle.motion`: how an obstacle moves, from what is written or from a CSV file."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated

import numpy as np
import pinocchio as pin
from pydantic import Field

from mbocp._arrays import Array
from mbocp._files import path_of, read_text
from mbocp._keys import Key, Table, Takes
from mbocp._text import show
from mbocp.exceptions import InvalidValue, ProblemError, Unreadable
from mbocp.robot.collision.obstacle_motion import ObstacleMotion
from mbocp.terms.written import Finite, Triple

_MOST_BYTES = 10_000_000
_POSITION = ("x", "y", "z")
_ORIENTATIONS = (("roll", "pitch", "yaw"), ("qx", "qy", "qz", "qw"), ())
_STEADY = ("velocity", "angular_velocity", "about", "during")
_TABULATED = ("times", "positions", "orientations")
_Rows = Annotated[list[list[Finite]] | None, Takes("list of rows")]


class MotionTable(Table):
    """A steady motion, or poses at some times."""

    velocity: Annotated[Triple, Key("of a steady motion, in the axes of the world", "m/s", "0")] = None
    angular_velocity: Annotated[Triple, Key("likewise", "rad/s", "0")] = None
    about: Annotated[Triple, Key("the point that it turns about", "m", "`position` of the obstacle")] = None
    during: Annotated[
        list[Finite] | None,
        Field(min_length=2, max_length=2),
        Key("when a steady motion begins and ends; else it goes on for ever from 0", "s", "", "2 numbers"),
    ] = None
    times: Annotated[
        list[Finite] | None, Key("at which poses are given; before and after, it stands still", "s")
    ] = None
    positions: Annotated[
        _Rows,
        Key(
            "at these times, of the frame in which `position` and `rpy` are",
            "m",
            "",
            "list of 3 numbers each",
        ),
    ] = None
    orientations: Annotated[
        _Rows,
        Key(
            "of this frame: roll, pitch, yaw, or quaternions xyzw",
            "rad",
            "none",
            "list of 3 or 4 numbers each",
        ),
    ] = None
    file: Annotated[
        str | None,
        Key(
            "a CSV with columns t, x, y, z, and roll, pitch, yaw or qx, qy, qz, qw where it turns",
            "",
            "",
            "path",
        ),
    ] = None


def read_motion(table: MotionTable, position: list[float] | None, folder: Path) -> ObstacleMotion:
    """Make the motion of an obstacle that is at a position when a steady one begins.

    Raises
    ------
    ProblemError, InvalidValue
        If keys do not fit each other, or a value cannot be right.
    """
    given = table.model_fields_set
    ways = [keys for keys in (_STEADY, _TABULATED, ("file",)) if given & set(keys)]
    if len(ways) != 1:
        raise ProblemError(
            f"motion: got {show(sorted(given))}, expected velocity or angular_velocity, or times and "
            "positions, or file"
        )
    if ways[0] is _STEADY:
        if not given & {"velocity", "angular_velocity"}:
            raise ProblemError("motion: needs velocity or angular_velocity")
        if table.about is not None and table.angular_velocity is None:
            raise ProblemError("motion.about: without angular_velocity nothing turns")
        zero = [0.0] * 3
        origin = table.about or position or zero
        rates = np.array(table.velocity or zero), np.array(table.angular_velocity or zero)
        return ObstacleMotion.steady(np.array(origin), *rates, table.during)
    if table.file is not None:
        return ObstacleMotion.through(*_read_file(folder / path_of(table.file)))
    if table.times is None or table.positions is None:
        raise ProblemError("motion: times and positions go together")
    positions = _rows("positions", table.positions, (3,), len(table.times))
    turned = table.orientations
    orientations = np.zeros((len(table.times), 0))
    if turned is not None:
        orientations = _rows("orientations", turned, (3, 4), len(table.times))
    return ObstacleMotion.through(np.array(table.times), positions, _quaternions(orientations))


def _rows(name: str, rows: list[list[float]], lengths: tuple[int, ...], count: int) -> Array:
    sizes = {len(row) for row in rows}
    if len(rows) != count or len(sizes) != 1 or not sizes <= set(lengths):
        expected = f"a row of {' or '.join(map(str, lengths))} numbers for each of {count} times"
        raise InvalidValue(f"motion.{name}", f"{len(rows)} rows of {sorted(sizes)} numbers", expected)
    return np.array(rows)


def _quaternions(rows: Array) -> Array:
    """Of rows of roll, pitch and yaw, of quaternions, or of nothing."""
    if rows.shape[1] == 4:
        return rows
    if rows.shape[1] == 0:
        return np.tile([0.0, 0.0, 0.0, 1.0], (len(rows), 1))
    return np.array([pin.Quaternion(pin.rpy.rpyToMatrix(row)).coeffs() for row in rows])


def _read_file(path: Path) -> tuple[Array, Array, Array]:
    """Times, positions and quaternions."""
    try:
        text = read_text(path, expected="a CSV table", limit=_MOST_BYTES)
        header, *lines = list(csv.reader(text.splitlines())) or [[]]
    except (Unreadable, csv.Error) as error:
        reason = getattr(error, "reason", f"is no CSV table ({error})")
        raise ProblemError(f"motion.file: {path} {reason}") from error
    names = [column.partition(" [")[0].strip() for column in header]
    turned = next(columns for columns in _ORIENTATIONS if set(columns) <= set(names))
    wanted = ["t", *_POSITION, *turned]
    missing = [name for name in wanted if name not in names]
    if missing:
        raise ProblemError(
            f"motion.file: {path} has no column {', '.join(missing)}; it has {', '.join(names)}"
        )
    try:
        rows = [[float(line[names.index(name)]) for name in wanted] for line in lines if line]
    except (ValueError, IndexError) as error:
        raise ProblemError(f"motion.file: {path} has a row that is not all numbers ({error})") from error
    found = np.array(rows).reshape(-1, len(wanted))
    return found[:, 0], found[:, 1:4], _quaternions(found[:, 4:])
