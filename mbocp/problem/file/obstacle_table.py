"""`[[obstacle]]` and `self_collision`: their keys, from what is written to shapes, and back."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import coal
import numpy as np
import pinocchio as pin
from pydantic import Field

from mbocp._arrays import Array
from mbocp._files import path_of
from mbocp._keys import Key, Table
from mbocp._text import shorten, show
from mbocp.exceptions import InvalidValue, ProblemError, Unreadable, locate
from mbocp.meshes.points import read_heights, read_points
from mbocp.meshes.triangles import triangles_of
from mbocp.problem._checks import choice
from mbocp.problem.file.motion_table import MotionTable, read_motion, spheres_of_result
from mbocp.problem.obstacles.clearance import SelfCollision
from mbocp.robot.collision.compound import CONCAVITY, Compound
from mbocp.robot.collision.covering_boxes import (
    CLOUD,
    HEIGHTS,
    RESOLUTION,
    Boxes,
    boxes_of_cloud,
    boxes_of_heights,
)
from mbocp.robot.collision.geometry import LinkShape
from mbocp.robot.collision.hull import Hull, hull_of
from mbocp.robot.collision.mesh_file import body_of, body_of_file
from mbocp.robot.collision.obstacle import MESH, SHAPES, SIZES, SMOOTHING, Obstacle
from mbocp.robot.collision.obstacle_motion import ObstacleMotion
from mbocp.terms.written import Finite, Positive, Quaternion, Triple

SCENE = "scene"  # not one shape, but all of a file
_OF_FILES = ("scale", "hull", "concavity")
_WRITTEN = ("vertices", "faces", "parts")
_OF_GRIDS = {CLOUD: ("points",), HEIGHTS: ("heights", "cell")}  # the first in place of a file
_OF_RESULTS = {"name", "result", "position", "rpy", "orientation", "margin"}
_LENGTHS = tuple(dict.fromkeys(key for keys in SIZES.values() for key in keys))


class ObstacleTable(Table):
    """A shape that links keep away from."""

    name: Annotated[str | None, Key("its name", "", "shape and number")] = None
    shape: Annotated[
        str | None,
        choice((*SHAPES, SCENE)),
        Key(
            "a [mesh](obstacles.md#meshes), convex or not; a [cloud or a height "
            "map](obstacles.md#clouds-and-height-maps); a [scene](obstacles.md#scenes) has many shapes",
            "",
            "required without `result`",
        ),
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
            "of a sphere, capsule (`length` without its round ends), cylinder, along z",
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
            "of a mesh (STL, Collada, OBJ, PLY; or `vertices`), a cloud (or `points`), a height map (or "
            "`heights`) or a scene, beside the problem file",
            "",
            "required",
            "path",
        ),
    ] = None
    scale: Annotated[
        Finite | list[Finite] | None,
        Key("of a unit of the file; of a height map of its heights alone", "m", "1", "number > 0, or 3"),
    ] = None
    hull: Annotated[
        bool,
        Key("whether the convex hull stands for what is [not convex or not closed](obstacles.md#meshes)"),
    ] = False
    concavity: Annotated[
        Positive,
        Key("that CoACD leaves in [parts](obstacles.md#meshes) of what is not convex; less: more parts"),
    ] = CONCAVITY
    vertices: Annotated[
        list[list[Finite]] | None,
        Key("corners of a mesh, in place of a file", "m", "", "list of 3 numbers each"),
    ] = None
    faces: Annotated[
        list[list[int]] | None,
        Key("triangles of `vertices`, if these are not convex", "", "", "list of 3 numbers each"),
    ] = None
    parts: Annotated[
        list[list[list[Finite]]] | None,
        Key("corners of each convex part of `faces`", "m", "", "list of lists of 3 numbers each"),
    ] = None
    points: Annotated[list[list[Finite]] | None, Key("of a cloud", "m", "", "list of 3 numbers each")] = None
    resolution: Annotated[
        Positive,
        Key("side of the cubes of a cloud; by how much boxes may be higher than cells of heights", "m"),
    ] = RESOLUTION
    heights: Annotated[
        list[list[float]] | None,
        Key("rows along x from the largest y on; nan: there is nothing", "m", "", "list of lists"),
    ] = None
    cell: Annotated[Positive | None, Key("from height to height", "m", "required")] = None
    position: Annotated[Triple, Key("of the centre; of a halfspace a point of its surface", "m", "0")] = None
    rpy: Annotated[
        Triple,
        Key(
            "roll, pitch, yaw, or quaternion xyzw; a halfspace is below z = 0",
            "rad",
            "as `frame`",
            "3 or 4 numbers",
            ("orientation",),
        ),
    ] = None
    orientation: Quaternion = None
    frame: Annotated[str | None, Key("frame that carries it", "", '`"world"`')] = None
    motion: Annotated[MotionTable | None, Key("how it [moves](obstacles.md#moving-obstacles)", "", "not")] = (
        None
    )
    margin: Annotated[Finite, Key("least distance", "m")] = 0.0
    smoothing: Annotated[Positive, Key("length over which edges are rounded", "m")] = SMOOTHING
    movable: Annotated[bool, Key("whether [moving it compiles nothing](obstacles.md#what-is-kept)")] = False


class SelfCollisionTable(Table):
    """How links keep away from each other."""

    margin: Annotated[Finite, Key("least distance of links", "m")] = 0.0
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
    found: list[Obstacle] = []
    for index, table in enumerate(obstacle_table):
        found += _obstacles(table, index, folder or Path())
    return tuple(found)


def self_collision_from(
    self_collision_table: SelfCollisionTable | None, folder: Path | None = None
) -> SelfCollision | None:
    """Make what is said of links that meet; None: nothing."""
    if self_collision_table is None:
        return None
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


def _of_scene(table: ObstacleTable, key: str, folder: Path) -> Iterator[Obstacle]:
    """One obstacle for each shape of a scene's file, with the frame, margin and smoothing of the table."""
    from mbocp.robot.loading.scene_shapes import read_scene  # it imports yaml, and few problems have scenes

    _sizes(table, key)
    with locate(key):
        _refuse(table, ("scale", *_WRITTEN), f'shape = "{SCENE}" does not use it')
        if table.file is None:
            raise ProblemError(f'shape = "{SCENE}" needs file')
        path = folder / path_of(table.file)
        shapes = read_scene(path)
        motion = _motion(table, folder)
    turn = pin.Quaternion(np.array(_orientation(table, key))).normalized()
    base = pin.SE3(turn.matrix(), np.array(table.position or [0.0] * 3))
    counts = Counter(shape.link for shape in shapes)
    for shape in shapes:
        words = [f"{table.name}/" if table.name else "", shape.link]
        name = "".join(words) + (f" {shape.number + 1}" if counts[shape.link] > 1 else "")
        at = base * shape.placement
        with locate(key), locate(f"obstacle {name!r}"):
            body, excess = _body_of_shape(shape, table, path)
            kind, sizes = _kind(shape.geometry) if body is None else (MESH, [])
            place = at.translation, pin.Quaternion(at.rotation).coeffs()
            yield _of_table(table, name, (kind, sizes), place, (body, excess), motion)


def _of_table(
    table: ObstacleTable,
    name: str,
    shape: tuple[str, list[float]],
    place: tuple[Any, Any],
    body: tuple[Hull | Compound | Boxes | None, float],
    motion: ObstacleMotion | None,
) -> Obstacle:
    """An obstacle with its lengths, its place, its body with the excess; all else is the table's."""
    kind, sizes = shape
    return Obstacle(
        name=name,
        shape=kind,
        sizes=np.array(sizes),
        position=np.array(place[0]),
        orientation=np.array(place[1]),
        frame=table.frame or "world",
        margin=table.margin,
        smoothing=table.smoothing,
        movable=table.movable,
        hull=body[0] if isinstance(body[0], Hull) else None,
        compound=body[0] if isinstance(body[0], Compound | Boxes) else None,
        excess=body[1],
        motion=motion,
    )


def _motion(table: ObstacleTable, folder: Path) -> ObstacleMotion | None:
    return None if table.motion is None else read_motion(table.motion, table.position, folder)


def _body_of_shape(
    shape: LinkShape, table: ObstacleTable, path: Path
) -> tuple[Hull | Compound | None, float]:
    """Body of a mesh of a scene."""
    if shape.mesh:
        return body_of_file(Path(shape.mesh), shape.scale, table.hull, table.concavity)
    if isinstance(shape.geometry, coal.BVHModelBase):
        return body_of(*triangles_of(shape.geometry), table.hull, table.concavity, shorten(str(path)))
    return None, 0.0


def _kind(shape: coal.CollisionGeometry) -> tuple[str, list[float]]:
    """Name and lengths of a shape."""
    if isinstance(shape, coal.Box):
        return "box", (2.0 * np.asarray(shape.halfSide)).tolist()
    if isinstance(shape, coal.Sphere):
        return "sphere", [float(shape.radius)]
    kind = {coal.Cylinder: "cylinder", coal.Capsule: "capsule"}.get(type(shape))
    if kind is None:
        raise InvalidValue("shape", type(shape).__name__, " or ".join(SHAPES))
    return kind, [float(shape.radius), 2.0 * float(shape.halfLength)]


def _obstacles(table: ObstacleTable, index: int, folder: Path) -> Iterable[Obstacle]:
    """One of a shape, many of a scene or a robot."""
    key = f"obstacle.{index}"
    if table.result is None:
        return (
            _of_scene(table, key, folder) if table.shape == SCENE else [_obstacle(table, key, index, folder)]
        )
    others = sorted(table.model_fields_set - _OF_RESULTS)
    if others:
        raise ProblemError(f"{key}.{others[0]}: with a result there are {', '.join(sorted(_OF_RESULTS))}")
    base = pin.XYZQUATToSE3(np.array([*(table.position or [0.0] * 3), *_orientation(table, key)]))
    path = folder / path_of(table.result)
    with locate(key):
        return spheres_of_result(path, base, table.name or f"robot {index + 1}", table.margin)


def _obstacle(table: ObstacleTable, key: str, index: int, folder: Path) -> Obstacle:
    if table.shape is None:
        raise ProblemError(f"{key}.shape: required: {' or '.join((*SHAPES, SCENE))}; or a result")
    sizes = _sizes(table, key) if table.shape in SHAPES else []
    orientation = _orientation(table, key)
    name = table.name or f"{table.shape} {index + 1}"
    with locate(key), locate(f"obstacle {name!r}"):
        grid = _grid(table, folder)
        body, motion = _body(table, folder) if grid is None else (grid, 0.0), _motion(table, folder)
    place = table.position or [0.0] * 3, orientation
    with locate(key):
        return _of_table(table, name, (table.shape, sizes), place, body, motion)


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
    return pin.Quaternion(pin.rpy.rpyToMatrix(np.array(table.rpy))).coeffs().tolist()


def _body(table: ObstacleTable, folder: Path) -> tuple[Hull | Compound | None, float]:
    """Body of a mesh, and by how much a hull is larger than its file."""
    if table.shape != MESH:
        words = f'shape = "{table.shape}" does not use it, but "{MESH}" does'
        _refuse(table, ("file", *_OF_FILES, *_WRITTEN), words)
        return None, 0.0
    if (table.file is None) == (table.vertices is None):
        raise ProblemError(f'shape = "{MESH}" needs file or vertices, one of them')
    if table.vertices is not None:
        _refuse(table, _OF_FILES, "of a file; vertices are in metres, and `parts` says what these are")
        return _body_of(table.vertices, table.faces, table.parts), 0.0
    _refuse(table, _WRITTEN, "of vertices, not of a file")
    file, scale = folder / path_of(str(table.file)), np.broadcast_to(_scale(table), (3,))
    return body_of_file(file, scale, table.hull, table.concavity)


def _grid(table: ObstacleTable, folder: Path) -> Boxes | None:
    """Boxes of a cloud or a height map."""
    own, words = _OF_GRIDS.get(table.shape or "", ()), f'shape = "{table.shape}" does not use it'
    others = [key for keys in _OF_GRIDS.values() for key in keys if key not in own]
    _refuse(table, [*others, *((*_WRITTEN, *_OF_FILES[1:]) if own else ("resolution",))], words)
    if not own:
        return None
    written, is_cloud = getattr(table, own[0]), table.shape == CLOUD
    if (table.file is None) == (written is None) or any(getattr(table, key) is None for key in own[1:]):
        what = " and ".join([f"file or {own[0]}, one of them", *own[1:]])
        raise ProblemError(f'shape = "{table.shape}" needs {what}')
    if table.file is not None:
        path = folder / path_of(table.file)
        try:
            numbers = (read_points if is_cloud else read_heights)(path)
        except Unreadable as error:
            what = "a cloud: PLY, PCD, NPY, XYZ or CSV" if is_cloud else "heights: NPY, CSV, PNG or TIFF"
            raise InvalidValue("file", f"{shorten(str(path))}, which {error}", what) from error
        scale = _scale(table)
        if not is_cloud and scale.shape:
            raise InvalidValue("scale", show(table.scale), "one number: of a unit of heights [m]")
        numbers = numbers * scale
    else:
        _refuse(table, ("scale",), f"of a file; {own[0]} are in metres")
        if len({len(row) for row in written}) != 1:
            raise InvalidValue(own[0], "none, or rows of different lengths", "rows of one length [m]")
        numbers = np.array(written)
    if is_cloud:
        return boxes_of_cloud(numbers, table.resolution)
    return boxes_of_heights(numbers, table.cell or 0.0, table.resolution)


def _scale(table: ObstacleTable) -> Array:
    """Of a unit of a file, one number or three [m]."""
    scale = np.asarray(1.0 if table.scale is None else table.scale, dtype=np.float64)
    if scale.shape not in ((), (3,)) or not np.all(scale > 0.0):
        raise InvalidValue("scale", show(table.scale), "one number or three above 0 [m]")
    return scale


def _refuse(table: ObstacleTable, names: Sequence[str], why: str) -> None:
    for name in names:
        if name in table.model_fields_set:
            raise ProblemError(f"{name}: {why}")


def _body_of(
    vertices: list[list[float]], faces: list[list[int]] | None, parts: list[list[list[float]]] | None
) -> Hull | Compound:
    """Body by its corners; without `faces` their hull."""
    if (faces is None) != (parts is None):
        raise ProblemError("faces and parts: both of a body that is not convex, or neither")
    corners = [*vertices, *(corner for part in parts or [] for corner in part)]
    if any(len(row) != 3 for row in corners) or any(len(face) != 3 for face in faces or []):
        expected = "three numbers for each corner [m] and each face"
        raise InvalidValue("vertices, faces or parts", "a row of another length", expected)
    if faces is None or parts is None:
        return hull_of(np.array(vertices))
    if not parts:
        raise InvalidValue("parts", "none", "one or more")
    hulls = tuple(hull_of(np.array(part)) for part in parts)
    return Compound(np.array(vertices), np.array(faces, dtype=np.int64), hulls)
