"""`obstacle.motion`: how an obstacle moves, from what is written or from a CSV file.

A robot whose motion a result says is an obstacle, too: spheres of its links, which move by the time.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import pinocchio as pin
from pydantic import Field

from mbocp._arrays import Array
from mbocp._files import path_of, read_text
from mbocp._keys import Key, Table, Takes
from mbocp._text import show
from mbocp.exceptions import InvalidValue, ProblemError, ResultFileError, Unreadable
from mbocp.robot import Robot, robot_from_spec
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.robot.collision.obstacle_motion import ObstacleMotion
from mbocp.robot.large import make_working_data
from mbocp.robot.nodes import between
from mbocp.storage.seal import read_image
from mbocp.terms.written import Finite, Triple

if TYPE_CHECKING:
    from mbocp.storage.content import FileContent

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

    def choose(names: Sequence[str]) -> list[str]:
        turned = next(columns for columns in _ORIENTATIONS if set(columns) <= set(names))
        wanted = ["t", *_POSITION, *turned]
        missing = [name for name in wanted if name not in names]
        if missing:
            raise ProblemError(
                f"motion.file: {path} has no column {', '.join(missing)}; it has {', '.join(names)}"
            )
        return wanted

    found = read_columns(path, "motion.file", _MOST_BYTES, choose)
    return found[:, 0], found[:, 1:4], _quaternions(found[:, 4:])


def read_columns(path: Path, key: str, limit: int, choose: Callable[[Sequence[str]], Sequence[str]]) -> Array:
    """Read columns of a CSV table with a header: those that `choose` takes of its names, without units.

    Raises
    ------
    ProblemError
        If there is no such file, it is no table, or a row is not all numbers.
    """
    try:
        text = read_text(path, expected="a CSV table", limit=limit)
        header, *rows = list(csv.reader(text.splitlines())) or [[]]
    except (Unreadable, csv.Error) as error:
        reason = getattr(error, "reason", f"is no CSV table ({error})")
        raise ProblemError(f"{key}: {path} {reason}") from error
    names = [column.partition(" [")[0].strip() for column in header]
    columns = [names.index(name) for name in choose(names)]
    try:
        table = np.array([[float(row[i]) for i in columns] for row in rows if row])
    except (ValueError, IndexError) as error:
        raise ProblemError(f"{key}: {path} has a row that is not all numbers ({error})") from error
    return table.reshape(-1, len(columns))


def read_result(path: Path, key: str) -> FileContent:
    """Read the content of a result.

    Raises
    ------
    ProblemError
        If it is none.
    """
    from mbocp.storage.hdf5 import content_of  # HDF5 only for those who name a result

    try:
        return content_of(path, read_image(path))
    except ResultFileError as error:
        raise ProblemError(f"{key}: {path} {error.reason}") from error


def spheres_of_result(path: Path, base: pin.SE3, name: str, margin: float) -> tuple[Obstacle, ...]:
    """Make an obstacle of each sphere of the robot of a result.

    Parameters
    ----------
    path : Path
        Of the result.
    base : pin.SE3
        Where the robot's world is.
    name : str
        What the robot is called.
    margin : float
        [m].

    Raises
    ------
    ProblemError
        If there is no such result, or its robot has no collision geometry.
    """
    robot, t, qs = _read(path)
    if not robot.collision_spheres:
        raise ProblemError(f"result: robot {robot.name!r} of {path} has no collision geometry")
    middles = between(robot, qs[:-1], qs[1:], np.full(len(qs) - 1, 0.5))
    times, order = np.unique(np.concatenate([t, (t[:-1] + t[1:]) / 2.0]), return_index=True)
    poses = _link_poses(robot, base, np.vstack([qs, middles])[order])
    found = []
    for link, along in zip(robot.collision_spheres, poses, strict=True):
        motion = ObstacleMotion.through(times, along[:, :3], along[:, 3:])
        for number, (center, radius) in enumerate(zip(link.centers, link.radii, strict=True)):
            named, size = f"{name}/{link.link}[{number}]", np.array([radius])
            sphere = Obstacle(
                name=named, shape="sphere", sizes=size, position=center, margin=margin, motion=motion
            )
            found.append(sphere)
    return tuple(found)


def _read(path: Path) -> tuple[Robot, Array, Array]:
    """Robot, times and configurations; impacts, which take no time, once."""
    if not path.is_file():
        raise ProblemError(f"result: no such file {str(path)!r}")
    content = read_result(path, "result")
    t, qs = content.arrays["t"], content.arrays["qs"]
    t, once = np.unique(t, return_index=True)
    return robot_from_spec(content.structures["robot_spec"]), t, qs[once]


def _link_poses(robot: Robot, base: pin.SE3, qs: Array) -> Array:
    """Positions and quaternions of the frames with spheres, shape (links, n, 7)."""
    data = make_working_data(robot.model)
    found = np.empty((len(robot.collision_spheres), len(qs), 7))
    for n, q in enumerate(qs):
        pin.framesForwardKinematics(robot.model, data, q)
        for k, link in enumerate(robot.collision_spheres):
            found[k, n] = pin.SE3ToXYZQUAT(base * data.oMf[link.frame])
    return found
