"""Shapes of a scene: a URDF, an SDF or an MJCF whose links stand still, or a planning scene of MoveIt."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from mbocp._files import read_text
from mbocp._text import shorten, show
from mbocp.exceptions import RobotFileError, Unreadable
from mbocp.robot.collision.geometry import LinkShape, mesh_of
from mbocp.robot.loading.description import ReadOptions
from mbocp.robot.loading.readers.robot_yaml import parse_yaml
from mbocp.robot.loading.robot_formats import reader_of

_LIMIT = 64 * 2**20  # [bytes] of a planning scene, whose meshes stand in it
# Lengths of a shape, by their order in `.scene` and in messages of ROS, and what makes it of them.
_SHAPES: Mapping[str, tuple[int, str, Callable[..., coal.CollisionGeometry]]] = {
    "box": (3, "xyz", coal.Box),
    "sphere": (1, "r", coal.Sphere),
    "cylinder": (2, "lr", coal.Cylinder),
}


def read_scene(path: Path) -> tuple[LinkShape, ...]:
    """Read the shapes that stand in a scene, placed in its own axes.

    Raises
    ------
    RobotFileError
        If the file cannot be read, has no shapes, one of another kind, or a link that moves.
    """
    readers = {".scene": _of_scene, ".yaml": _of_yaml, ".yml": _of_yaml}
    reader = readers.get(path.suffix.lower())
    found = tuple(_of_links(path)) if reader is None else _read_planning_scene(path, reader)
    if not found:
        raise RobotFileError(path, "has no shapes that links collide with")
    return found


def _read_planning_scene(path: Path, reader: Callable[[Path], Iterator[LinkShape]]) -> tuple[LinkShape, ...]:
    try:
        return tuple(reader(path))
    except Unreadable as error:
        raise RobotFileError(path, str(error)) from error
    except (KeyError, IndexError, RuntimeError, TypeError, ValueError, AttributeError) as error:
        what = "planning scene of MoveIt, whose objects are in world: collision_objects in YAML"
        reason = f"is no {what}, or cut off ({shorten(repr(error))})"
        raise RobotFileError(path, reason) from error


def _of_links(path: Path) -> Iterator[LinkShape]:
    """Solid shapes of a robot's links, of which none may move."""
    read = reader_of(path).read(path, path.stem, ReadOptions(free_flyer=False))
    for source in read.shapes:
        for shape in source.solid():
            name = source.prefix + shape.link
            frame = read.model.frames[read.model.getFrameId(name, pin.FrameType.BODY)]
            if frame.parentJoint:
                joint = read.model.names[frame.parentJoint]
                reason = f"link {show(name)} moves by joint {show(joint)}; in a scene all joints are fixed"
                raise RobotFileError(path, reason)
            yield _shape(name, shape.number, shape.geometry, frame.placement * shape.placement, shape)


def _shape(
    name: str, number: int, geometry: coal.CollisionGeometry, at: pin.SE3, mesh: LinkShape | None = None
) -> LinkShape:
    file, scale = ("", np.ones(3)) if mesh is None else (mesh.mesh, mesh.scale)
    return LinkShape(name, number, f"{show(name)}, shape {number}", geometry, file, scale, at)


def _of_yaml(path: Path) -> Iterator[LinkShape]:
    """`moveit_msgs/PlanningScene` as YAML, as MotionBenchMaker has it."""
    for thing in parse_yaml(read_text(path, limit=_LIMIT))["world"]["collision_objects"] or ():
        name, base = thing["id"], _pose(thing.get("pose", {}))
        if thing.get("planes"):
            raise RobotFileError(path, f"object {show(name)}: planes are not read; give a halfspace")
        solids, places = thing.get("primitives") or (), thing.get("primitive_poses") or ()
        made = [_primitive(path, name, one["type"], map(float, one["dimensions"])) for one in solids]
        meshes = thing.get("meshes") or ()
        for mesh in meshes:
            corners = [_row(corner, "xyz") for corner in mesh["vertices"]]
            faces = [face["vertex_indices"] if isinstance(face, dict) else face for face in mesh["triangles"]]
            made.append(mesh_of(np.array(corners), np.array(faces, dtype=int)))
        poses = [_pose(place) for place in (*places, *(thing.get("mesh_poses") or ()))]
        for number, (geometry, at) in enumerate(zip(made, poses, strict=True)):
            yield _shape(name, number, geometry, base * at)


def _pose(given: Mapping[str, Any]) -> pin.SE3:
    position, turn = given.get("position", [0.0] * 3), given.get("orientation", [0.0, 0.0, 0.0, 1.0])
    return _placement([*_row(position, "xyz"), *_row(turn, "xyzw")])


def _row(given: Mapping[str, Any] | Sequence[Any], names: str) -> list[float]:
    """Numbers of a list, as MotionBenchMaker writes them, or of a table of x, y, z and w in any order."""
    return [float(x) for x in (map(given.__getitem__, names) if isinstance(given, Mapping) else given)]


def _placement(numbers: list[float]) -> pin.SE3:
    """Position, and quaternion xyzw."""
    turn = pin.Quaternion(np.array(numbers[3:7])).normalized()
    return pin.SE3(turn.matrix(), np.array(numbers[:3]))


def _primitive(path: Path, name: str, kind: str, sizes: Iterator[float]) -> coal.CollisionGeometry:
    """Shape of its sizes in the order of messages of ROS."""
    if kind not in _SHAPES:
        known = ", ".join((*_SHAPES, "mesh"))
        raise RobotFileError(path, f"object {show(name)}: shape {show(kind)} is not read, but {known}")
    count, order, make = _SHAPES[kind]
    lengths = [next(sizes) for _ in range(count)]
    return make(*(lengths[::-1] if order == "lr" else lengths))


def _of_scene(path: Path) -> Iterator[LinkShape]:
    """MoveIt's `.scene`: objects have a pose of their own and subframes where the first one has."""
    lines = [line.strip() for line in read_text(path, limit=_LIMIT).splitlines() if line.strip()]
    first = next(k for k, line in enumerate(lines) if line.startswith("*"))
    is_new = len(lines[first + 1].split()) > 1
    rest = iter(lines[first:])
    for line in rest:
        if line == ".":
            return
        name, words = line.removeprefix("*").strip(), _words(rest)
        base = _placement(_numbers(words, 7)) if is_new else pin.SE3.Identity()
        for number in range(int(next(words))):
            kind = next(words)
            geometry = _mesh(words) if kind == "mesh" else _of_words(path, name, kind, words)
            at = _placement(_numbers(words, 7))
            _numbers(words, 4)  # colour
            yield _shape(name, number, geometry, base * at)
        for _ in range(int(next(words)) if is_new else 0):
            next(rest)  # name of a subframe
            _numbers(words, 7)
    raise ValueError("no '.' at its end")


def _words(lines: Iterator[str]) -> Iterator[str]:
    """Words of lines, one line after the other: a line that is begun is read to its end."""
    for line in lines:
        yield from line.split()


def _numbers(words: Iterator[str], count: int) -> list[float]:
    return [float(next(words)) for _ in range(count)]


def _of_words(path: Path, name: str, kind: str, words: Iterator[str]) -> coal.CollisionGeometry:
    """Of a cylinder the file has the radius first."""
    sizes = _numbers(words, _SHAPES[kind][0]) if kind in _SHAPES else []
    return _primitive(path, name, kind, iter(sizes[::-1] if kind == "cylinder" else sizes))


def _mesh(words: Iterator[str]) -> coal.CollisionGeometry:
    corners, faces = int(next(words)), int(next(words))
    vertices = np.array(_numbers(words, 3 * corners)).reshape(-1, 3)
    return mesh_of(vertices, np.array([int(next(words)) for _ in range(3 * faces)]).reshape(-1, 3))
