"""`[[obstacle]]` and `self_collision`: their keys, from what is written to shapes, and back."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from pydantic import Field

from mbocp._files import path_of
from mbocp._keys import Key, Table
from mbocp._text import show
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem._checks import choice
from mbocp.problem.file.messages import locate
from mbocp.problem.file.motion_table import MotionTable, read_motion
from mbocp.problem.file.moving_robot import spheres_of_result
from mbocp.problem.obstacles.clearance import SelfCollision
from mbocp.robot.collision.hull import Hull, hull_of, hull_of_file
from mbocp.robot.collision.obstacle import MESH, SHAPES, SIZES, SMOOTHING, Obstacle
from mbocp.terms.written import Finite, Positive, Quaternion, Triple

_OF_RESULTS = {"name", "result", "position", "rpy", "orientation", "margin"}
_LENGTHS = tuple(dict.fromkeys(key for keys in SIZES.values() for key in keys))


class ObstacleTable(Table):
    """A shape that links keep away from."""

    name: Annotated[
        str | None,
        Key(
            "its name; one table `[[obstacle]]` each",
            "",
            "shape and number",
        ),
    ] = None
    shape: Annotated[
        str | None,
        choice(SHAPES),
        Key("a [mesh](obstacles.md#meshes) is a convex hull", "", "required without `result`"),
    ] = None
    result: Annotated[
        str | None,
        Key(
            "in place of a shape a [robot that moves](obstacles.md#robots-in-one-cell) as this result says; "
            "`position` and `rpy` are those of its world",
            takes="path",
        ),
    ] = None
    radius: Annotated[
        Positive | None,
        Key(
            "of a sphere, a capsule (`length` without its round ends) and a cylinder, both along z",
            "m",
            "required",
            beside=("length",),
        ),
    ] = None
    length: Positive | None = None
    size: Annotated[Triple, Key("sides of a box", "m", "required", "3 numbers > 0")] = None
    file: Annotated[
        str | None,
        Key(
            "of a mesh: STL, Collada, OBJ or PLY, beside the problem file; or `vertices`",
            "",
            "required",
            "path",
        ),
    ] = None
    scale: Annotated[
        Finite | list[Finite] | None, Key("of a unit of the file", "m", "1", "number > 0, or 3")
    ] = None
    hull: Annotated[
        bool,
        Key(
            "whether a file that is [not convex or not closed](obstacles.md#meshes) may stand for its "
            "convex hull"
        ),
    ] = False
    vertices: Annotated[
        list[list[Finite]] | None,
        Key("corners of a mesh, in the place of a file", "m", "", "list of 3 numbers each"),
    ] = None
    position: Annotated[
        Triple, Key("of the centre in `frame`; of a halfspace a point of its surface", "m", "0")
    ] = None
    rpy: Annotated[
        Triple,
        Key(
            "roll, pitch, yaw, or quaternion xyzw; a halfspace fills what is below its z = 0",
            "rad",
            "as `frame`",
            "3 or 4 numbers",
            ("orientation",),
        ),
    ] = None
    orientation: Quaternion = None
    frame: Annotated[str | None, Key("frame of the robot that carries it", "", '`"world"`')] = None
    motion: Annotated[MotionTable | None, Key("how it [moves](obstacles.md#moving-obstacles)", "", "not")] = (
        None
    )
    margin: Annotated[Finite, Key("least distance", "m")] = 0.0
    smoothing: Annotated[Positive, Key("length over which edges are rounded in the equations", "m")] = (
        SMOOTHING
    )
    movable: Annotated[
        bool,
        Key(
            "whether it is [moved from problem to problem](obstacles.md#what-is-kept): moving it compiles "
            "nothing"
        ),
    ] = False


class SelfCollisionTable(Table):
    """How links keep away from each other."""

    margin: Annotated[Finite, Key("least distance of links from each other", "m")] = 0.0
    of_parts: Annotated[
        Finite | None,
        Key(
            "least distance of links of different [parts](robots.md#several-robots-in-one-world)",
            "m",
            "`margin`",
        ),
    ] = None
    disabled: Annotated[list[list[str]], Key("pairs of links that need not", "", "none", "list of pairs")] = (
        Field(default_factory=list)
    )
    srdf: Annotated[str | None, Key("an SRDF with such pairs", "", "beside the URDF", "path")] = None


def obstacles_from(
    obstacle_table: Sequence[ObstacleTable], folder: Path | None = None
) -> tuple[Obstacle, ...]:
    """Make the obstacles from the tables of `[[obstacle]]`; files of meshes are in the folder.

    Raises
    ------
    ProblemError, InvalidValue
        If a key does not fit the shape, or a value cannot be right.
    """
    found = (_obstacles(table, i, folder or Path()) for i, table in enumerate(obstacle_table))
    return tuple(chain(*found))


def obstacle_tables(obstacles: Sequence[Obstacle]) -> list[dict[str, Any]]:
    """Return the tables that read back as the same obstacles."""
    return [obstacle.table for obstacle in obstacles]


def self_collision_from(
    self_collision_table: bool | SelfCollisionTable | None, folder: Path | None = None
) -> SelfCollision | None:
    """Make what is said of links that meet; None: nothing."""
    if self_collision_table is None or self_collision_table is False:
        return None
    if self_collision_table is True:
        return SelfCollision()
    srdf = None if self_collision_table.srdf is None else (folder or Path()) / self_collision_table.srdf
    for pair in self_collision_table.disabled:
        if len(pair) != 2:
            raise ProblemError(f"self_collision.disabled: got {show(pair)}, expected pairs of links")
    pairs = tuple((pair[0], pair[1]) for pair in self_collision_table.disabled)
    return SelfCollision(self_collision_table.margin, self_collision_table.of_parts, pairs, srdf)


def write_self_collision(own: SelfCollision | bool | None) -> dict[str, Any] | None:
    """Return the table that reads back as the same."""
    if not isinstance(own, SelfCollision):
        return None
    srdf = {} if own.srdf is None else {"srdf": str(own.srdf.resolve())}
    parts = {} if own.of_parts is None else {"of_parts": own.of_parts}
    return {"margin": own.margin, **parts, "disabled": [list(pair) for pair in own.disabled], **srdf}


def _obstacles(table: ObstacleTable, index: int, folder: Path) -> tuple[Obstacle, ...]:
    """One of a shape, many of a robot."""
    key = f"obstacle.{index}"
    if table.result is None:
        return (_obstacle(table, key, index, folder),)
    others = sorted(table.model_fields_set - _OF_RESULTS)
    if others:
        raise ProblemError(f"{key}.{others[0]}: with a result there are {', '.join(sorted(_OF_RESULTS))}")
    base = pin.XYZQUATToSE3(np.array([*(table.position or [0.0] * 3), *_orientation(table, key)]))
    path = folder / path_of(table.result)
    with locate(key):
        return spheres_of_result(path, base, table.name or f"robot {index + 1}", table.margin)


def _obstacle(table: ObstacleTable, key: str, index: int, folder: Path) -> Obstacle:
    if table.shape is None:
        raise ProblemError(f"{key}.shape: required: {' or '.join(SHAPES)}; or a result")
    sizes = _sizes(table, key) if table.shape in SHAPES else []
    orientation = _orientation(table, key)
    name = table.name or f"{table.shape} {index + 1}"
    with locate(key), locate(f"obstacle {name!r}"):
        hull, excess = _hull(table, folder)
        motion = None if table.motion is None else read_motion(table.motion, table.position, folder)
    with locate(key):
        return Obstacle(
            name=name,
            shape=table.shape,
            sizes=np.array(sizes),
            position=np.array(table.position or [0.0] * 3),
            orientation=np.array(orientation),
            frame=table.frame or "world",
            margin=table.margin,
            smoothing=table.smoothing,
            movable=table.movable,
            hull=hull,
            excess=excess,
            motion=motion,
        )


def _sizes(table: ObstacleTable, key: str) -> list[float]:
    """Lengths of the shape, in the order of `SIZES`."""
    wanted = SIZES.get(table.shape or "", {})
    given = [name for name in _LENGTHS if getattr(table, name) is not None]
    for name in given:
        if name not in wanted:
            used = " and ".join(wanted) or "no lengths"
            raise ProblemError(f'{key}.{name}: shape = "{table.shape}" does not use it, but {used}')
    for name in wanted:
        if name not in given:
            raise ProblemError(f'{key}.{name}: shape = "{table.shape}" needs it')
    return [length for name in wanted for length in np.atleast_1d(getattr(table, name)).tolist()]


def _orientation(table: ObstacleTable, key: str) -> list[float]:
    """Quaternion xyzw."""
    if table.rpy is None:
        return table.orientation or [0.0, 0.0, 0.0, 1.0]
    if table.orientation is not None:
        raise ProblemError(f"{key}: give rpy or orientation, not both")
    found: list[float] = pin.Quaternion(pin.rpy.rpyToMatrix(np.array(table.rpy))).coeffs().tolist()
    return found


def _hull(table: ObstacleTable, folder: Path) -> tuple[Hull | None, float]:
    """Hull of a mesh, and by how much it is larger than its file."""
    if table.shape != MESH:
        for name in ("file", "scale", "hull", "vertices"):
            if name in table.model_fields_set:
                raise ProblemError(f'{name}: shape = "{table.shape}" does not use it, but "{MESH}" does')
        return None, 0.0
    if (table.file is None) == (table.vertices is None):
        raise ProblemError(f'shape = "{MESH}" needs file or vertices, one of them')
    if table.vertices is not None:
        for name in ("scale", "hull"):
            if name in table.model_fields_set:
                raise ProblemError(f"{name}: of a file; vertices are in metres, and their hull is taken")
        if any(len(vertex) != 3 for vertex in table.vertices):
            raise InvalidValue("vertices", "a row of another length", "three numbers for each corner [m]")
        return hull_of(np.array(table.vertices)), 0.0
    assert table.file is not None
    scale = np.ones(3) if table.scale is None else np.asarray(table.scale, dtype=np.float64)
    if scale.shape not in ((), (3,)) or not np.all(scale > 0.0):
        raise InvalidValue("scale", show(table.scale), "one number or three above 0 [m]")
    return hull_of_file(folder / path_of(table.file), np.broadcast_to(scale, (3,)), table.hull)
