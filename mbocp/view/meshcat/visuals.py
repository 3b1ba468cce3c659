"""A robot's visuals as meshcat objects: STL, Collada and OBJ parsed, primitives by Pinocchio.

The scale of a mesh sits in the object's own matrix, below the node that is animated. Pinocchio's
MeshcatVisualizer puts it into the node's transform, where an animation would overwrite it.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._files import MEGABYTE
from mbocp._text import shorten, warn_caller
from mbocp.exceptions import ReplayError, Unreadable
from mbocp.meshes.mesh_parts import MeshPart, Surface, check_parts
from mbocp.meshes.pictures import Picture, picture_folders, read_picture
from mbocp.meshes.triangles import READERS, UNREADABLE, binary_stl, load_by_coal
from mbocp.robot import Robot
from mbocp.robot.collision.solid import CORNERS, box_around
from mbocp.view.meshcat.commands import colour_number, load_mesh, load_primitive, mg, pack_array, shape_object

_ENDLESS = 1e6  # [m]; planes and half-spaces reach to the largest number there is
_REPEAT = 1000  # three.js's RepeatWrapping, which Collada has by default
SCENE_LIMIT = 256 * MEGABYTE  # of all meshes and pictures of a page [bytes]
_GREY = (0.8, 0.8, 0.8)


class MeshLibrary:
    """The meshes of one scene; each file is parsed once.

    Parameters
    ----------
    robot : Robot
        Whose folders the pictures on meshes may come from.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._parsed: dict[str, tuple[MeshPart, ...]] = {}
        self._pictures: dict[Path, Picture] = {}
        self._refused: set[Path] = set()
        self._size = 0

    def draw(self, visual: pin.GeometryObject) -> dict[str, Any]:
        """The meshcat object (as its `set_object` command carries it) of one visual.

        Raises
        ------
        ReplayError
            If the file cannot be read or the shape has no picture.
        """
        try:
            shape = self._shape(visual)
        except UNREADABLE as error:
            raise ReplayError(
                f"{visual.meshPath}: mesh of {visual.name!r} cannot be read: {error}"
            ) from error
        if shape is None:
            raise ReplayError(f"visual {visual.name!r}: a {type(visual.geometry).__name__} cannot be drawn")
        return shape

    def corners(self, visual: pin.GeometryObject) -> Array:
        """Corners of the visual's bounding box in its joint's frame, shape (8, 3) [m]."""
        try:
            corners = self._box(visual)
        except UNREADABLE:  # a plane, which has no end: count its origin
            corners = np.zeros((8, 3))
        return np.asarray(corners @ visual.placement.rotation.T + visual.placement.translation)

    def _shape(self, visual: pin.GeometryObject) -> dict[str, Any] | None:
        suffix = Path(visual.meshPath).suffix.lower()
        if suffix == ".stl":
            (part,) = self._parts(visual.meshPath)
            drawn = _plain(mg.StlMeshGeometry.from_stream(io.BytesIO(binary_stl(part))), visual)
            drawn["geometries"][0]["type"] = "_meshfile_geometry"  # the viewer's newer name for it
            return _scale(drawn, visual.meshScale)
        if suffix in READERS:
            drawn = _paint(self._parts(visual.meshPath), visual, self._pictures)
            return _scale(drawn, visual.meshScale)
        # coal reads the other formats, and puts the scale into the vertices.
        is_mesh = bool(visual.meshPath) or isinstance(visual.geometry, coal.BVHModelBase)
        shape = load_mesh(self._solid(visual)) if is_mesh else load_primitive(visual)
        return None if shape is None else _plain(shape, visual)

    def _parts(self, path: str) -> tuple[MeshPart, ...]:
        if path not in self._parsed:
            parts = check_parts(READERS[Path(path).suffix.lower()](Path(path)))
            self._count(sum(part.vertices.nbytes + part.faces.nbytes for part in parts))
            self._parsed[path] = tuple(self._with_picture(path, part) for part in parts)
        return self._parsed[path]

    def _with_picture(self, mesh: str, part: MeshPart) -> MeshPart:
        """The part, without its picture if that is refused; there is one warning for each picture."""
        image = None if part.surface is None else part.surface.image
        if part.surface is None or image is None or image in self._pictures:
            return part
        if image not in self._refused:
            try:
                picture = read_picture(image, picture_folders(self._robot.sources, Path(mesh)))
                self._count(len(picture.content))
                self._pictures[image] = picture
                return part
            except (Unreadable, ValueError) as error:
                self._refused.add(image)
                words = f"{mesh}: shown without its picture {shorten(str(image))}, which {error}"
                warn_caller(words)
        colour = _GREY if part.surface.colour == (1.0, 1.0, 1.0) else part.surface.colour
        return replace(part, surface=Surface(colour))

    def _count(self, size: int) -> None:
        if self._size + size > SCENE_LIMIT:
            raise ValueError(f"all meshes and pictures have more than {SCENE_LIMIT / MEGABYTE:g} MB")
        self._size += size

    def _box(self, visual: pin.GeometryObject) -> Array:
        if Path(visual.meshPath).suffix.lower() in READERS:
            points = np.vstack([part.vertices for part in self._parts(visual.meshPath)]) * visual.meshScale
            return np.asarray(np.where(CORNERS > 0.0, points.max(axis=0), points.min(axis=0)))
        corners = box_around(self._solid(visual))
        if np.any(corners[0] > corners[-1]) or np.abs(corners).max() > _ENDLESS:
            raise ValueError(f"visual {visual.name!r} has no extent")
        return corners

    def _solid(self, visual: pin.GeometryObject) -> coal.CollisionGeometry:
        """The shape of a file that coal reads, or of none."""
        return load_by_coal(Path(visual.meshPath), visual.meshScale) if visual.meshPath else visual.geometry


def _plain(shape: Any, visual: pin.GeometryObject) -> dict[str, Any]:
    """A shape in the colour of the robot's file."""
    return shape_object(shape, _own_material(visual))


def _scale(drawn: dict[str, Any], scale: Array) -> dict[str, Any]:
    drawn["object"]["matrix"] = [float(x) for x in np.diag([*scale, 1.0]).ravel()]
    return drawn


def _own_material(visual: pin.GeometryObject) -> mg.Material:
    *colour, alpha = (float(c) for c in visual.meshColor)
    return mg.MeshPhongMaterial(color=colour_number(colour), opacity=alpha)


def _paint(
    parts: Sequence[MeshPart], visual: pin.GeometryObject, pictures: Mapping[Path, Picture]
) -> dict[str, Any]:
    """A mesh in its own colours, unless it is plain grey and the robot's file names a colour."""
    surfaces = list(dict.fromkeys(part.surface for part in parts))
    own = _has_colours(surfaces) or not visual.overrideMaterial
    if not own or surfaces == [None]:
        surfaces = [None]
        parts = [MeshPart(p.vertices, p.faces, p.normals, None, None) for p in parts]
    geometry = MergedGeometry(parts, surfaces)
    drawn = shape_object(geometry, mg.MeshPhongMaterial())
    drawn["materials"] = []
    materials = [_own_material(visual) if s is None else _surface_material(s, pictures) for s in surfaces]
    drawn["object"]["material"] = [material.lower_in_object(drawn) for material in materials]
    return drawn


def _has_colours(surfaces: Sequence[Surface | None]) -> bool:
    """Whether a file paints itself: a picture, two colours, or one that is not grey."""
    given = [surface for surface in surfaces if surface is not None]
    return len({s.colour for s in given}) > 1 or any(
        s.image is not None or max(s.colour) - min(s.colour) > 0.02 for s in given
    )


def _surface_material(surface: Surface, pictures: Mapping[Path, Picture]) -> mg.Material:
    picture = None
    if surface.image is not None:
        picture = mg.ImageTexture(_Image(pictures[surface.image]), wrap=[_REPEAT, _REPEAT])
    return mg.MeshPhongMaterial(color=colour_number(surface.colour), map=picture)


class _Image(mg.Image):  # type: ignore[misc]  # meshcat has no types
    """An image file inside the scene; meshcat's own class knows PNG only."""

    def __init__(self, picture: Picture) -> None:
        super().__init__()
        content = base64.b64encode(picture.content).decode("ascii")
        self._url = f"data:image/{picture.kind};base64,{content}"

    def lower(self, object_data: dict[str, Any]) -> dict[str, Any]:
        return {"uuid": self.uuid, "url": self._url}


class MergedGeometry(mg.Geometry):  # type: ignore[misc]
    """Mesh parts as one geometry with a group of triangles for each surface."""

    def __init__(self, parts: Sequence[MeshPart], surfaces: Sequence[Surface | None]) -> None:
        super().__init__()
        self._parts = sorted(parts, key=lambda part: surfaces.index(part.surface))
        self._surfaces = surfaces

    def lower(self, object_data: dict[str, Any]) -> dict[str, Any]:
        """As its `set_object` command carries it."""
        parts = self._parts
        starts = np.concatenate([[0], np.cumsum([len(part.vertices) for part in parts])])
        attributes = {
            "position": pack_array(np.vstack([part.vertices for part in parts]).T),
            "normal": pack_array(np.vstack([_normals(part) for part in parts]).T),
        }
        if any(surface is not None and surface.image for surface in self._surfaces):
            attributes["uv"] = pack_array(np.vstack([_uvs(part) for part in parts]).T)
        faces = np.vstack([part.faces + start for part, start in zip(parts, starts[:-1], strict=True)])
        data = {
            "attributes": attributes,
            "index": pack_array(faces.ravel().astype(np.uint32)),
            "groups": self._groups(),
        }
        return {"uuid": self.uuid, "type": "BufferGeometry", "data": data}

    def _groups(self) -> list[dict[str, int]]:
        groups, start = [], 0
        for index, surface in enumerate(self._surfaces):
            count = 3 * sum(len(part.faces) for part in self._parts if part.surface == surface)
            groups.append({"start": start, "count": count, "materialIndex": index})
            start += count
        return groups


def _normals(part: MeshPart) -> Array:
    if part.normals is not None:
        return part.normals
    a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)  # as long as twice the triangle's area, which is its weight
    normals = np.zeros_like(part.vertices)
    for k in range(3):
        np.add.at(normals, part.faces[:, k], across)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))


def _uvs(part: MeshPart) -> Array:
    return np.zeros((len(part.vertices), 2)) if part.uvs is None else part.uvs
