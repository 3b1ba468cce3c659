"""Shapes of links: as a robot's file says them, in coal, and what is said of spheres in robot.toml.

Pinocchio's own builder hands mesh files to assimp, whatever they are; these are read as those of a replay
are, see `mbocp.meshes`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp._text import shorten
from mbocp.exceptions import RobotFileError
from mbocp.meshes.mesh_parts import Indices
from mbocp.meshes.triangles import UNREADABLE, read_triangles
from mbocp.robot.payload import SHAPES, Payload, shape_name


@dataclass(frozen=True)
class CollisionSphere:
    """A sphere that moves with a frame.

    Attributes
    ----------
    frame : str
    center : (float, float, float)
        In the frame [m].
    radius : float
        [m].
    """

    frame: str
    center: tuple[float, float, float]
    radius: float


class LinkShape(NamedTuple):
    """A shape of a link.

    Attributes
    ----------
    link : str
    number : int
        Among the shapes of the link.
    where : str
        What it is called in messages.
    geometry : coal.CollisionGeometry
        Empty for a mesh.
    mesh : str
        Path of the mesh; empty if it is none.
    scale : ndarray, shape (3,)
        Of the mesh.
    placement : pin.SE3
        In the link.
    """

    link: str
    number: int
    where: str
    geometry: coal.CollisionGeometry
    mesh: str
    scale: Array
    placement: pin.SE3


@dataclass(frozen=True, eq=False)
class ShapeSource:
    """What a robot's file says of the shapes of its links; solid ones are read when they are asked for.

    Attributes
    ----------
    path : Path
        The file, for messages.
    solid : callable
        Gives the shapes that links collide with; raises `RobotFileError`.
    disabled : callable
        Gives pairs of links that need not keep away from each other.
    drawn : frozenset of str
        Links with shapes to draw, missing ones included.
    prefix : str
        What stands before the names of its links among the robot's frames.
    """

    path: Path
    solid: Callable[[], Iterator[LinkShape]]
    disabled: Callable[[], frozenset[frozenset[str]]] = frozenset
    drawn: frozenset[str] = frozenset()
    prefix: str = ""

    def within(self, prefix: str) -> ShapeSource:
        """The same where names have one more prefix."""
        return replace(self, prefix=prefix + self.prefix)


MAX_TRIANGLES = 1_000_000  # of all meshes of a robot; the largest that we know has 60,000
_MAX_SIZE = 1e6  # [m] of a mesh
_MIN_LENGTH = 1e-6  # [m] of a shape


def read_geometry(
    model: pin.Model,
    sources: Sequence[ShapeSource],
    payloads: Sequence[Payload] = (),
    visuals: pin.GeometryModel | None = None,
) -> pin.GeometryModel:
    """Shapes that the links of a robot collide with, in the frames of their joints.

    Parameters
    ----------
    model : pin.Model
        After locking; links are found in it by name.
    sources : sequence of ShapeSource
    payloads : sequence of Payload
        Those with a shape collide, too.
    visuals : pin.GeometryModel, optional
        Has the shapes of payloads.

    Returns
    -------
    pin.GeometryModel
        Meshes are `coal.BVHModelOBBRSS`. Empty if the file has no such shapes.

    Raises
    ------
    RobotFileError
        If a mesh is missing or cannot be read, or a shape has no size.
    """
    geometry = pin.GeometryModel()
    count = 0
    for source in sources:
        for shape in source.solid():
            added = _object(model, source, shape)
            count += getattr(added.geometry, "num_tris", 0)
            if count > MAX_TRIANGLES:
                reason = f"its collision meshes have more than {MAX_TRIANGLES} triangles; give simpler ones"
                raise RobotFileError(source.path, reason)
            geometry.addGeometryObject(added)
    drawn = {} if visuals is None else {shape.name: shape for shape in visuals.geometryObjects}
    for payload in payloads:
        if any(getattr(payload, key) is not None for key in SHAPES):
            geometry.addGeometryObject(pin.GeometryObject(drawn[shape_name(payload)]))
    return geometry


def _object(model: pin.Model, source: ShapeSource, shape: LinkShape) -> pin.GeometryObject:
    geometry, link = shape.geometry, source.prefix + shape.link
    _check_size(source.path, shape.where, geometry)
    if shape.mesh:
        geometry = _mesh(source.path, shape.where, Path(shape.mesh), shape.scale)
    if not model.existFrame(link, pin.FrameType.BODY):
        raise RobotFileError(source.path, f"{shape.where}: the robot's model has no body of this name")
    frame = model.getFrameId(link, pin.FrameType.BODY)
    at = model.frames[frame]
    placement = at.placement * shape.placement
    name = f"{link}_{shape.number}"
    return pin.GeometryObject(name, at.parentJoint, frame, placement, geometry, shape.mesh, np.ones(3))


def _check_size(path: Path, where: str, shape: coal.CollisionGeometry) -> None:
    sizes = [
        *(getattr(shape, key) for key in ("radius", "halfLength") if hasattr(shape, key)),
        *(np.asarray(shape.halfSide) if hasattr(shape, "halfSide") else ()),
    ]
    if sizes and min(sizes) < _MIN_LENGTH:
        raise RobotFileError(path, f"{where}: a length of {min(sizes):g} m, expected {_MIN_LENGTH:g} or more")


def read_mesh(path: Path, where: str, mesh: Path, scale: Array) -> tuple[Array, Indices]:
    """Corners, shape (V, 3) [m], and triangles, shape (F, 3), of a mesh file of a robot.

    Parameters
    ----------
    path, where : Path, str
        The robot's file, and what the shape is called, for messages.
    mesh : Path
    scale : ndarray, shape (3,)
        Metres of a unit of the mesh.

    Raises
    ------
    RobotFileError
        If it cannot be read, or is too large or too small.
    """
    try:
        vertices, faces = read_triangles(mesh)
    except UNREADABLE as error:
        reason = f"{where}: mesh {shorten(str(mesh))} cannot be read: {error}"
        raise RobotFileError(path, reason) from error
    vertices = vertices * scale
    if np.abs(vertices).max() > _MAX_SIZE or len(faces) > MAX_TRIANGLES:
        reason = f"{where}: mesh {shorten(str(mesh))} is larger than {_MAX_SIZE:g} m, or has more than"
        raise RobotFileError(path, f"{reason} {MAX_TRIANGLES} triangles")
    if not np.ptp(vertices, axis=0).max() >= _MIN_LENGTH:
        raise RobotFileError(path, f"{where}: mesh {shorten(str(mesh))} has no extent")
    return vertices, faces


def _mesh(path: Path, where: str, mesh: Path, scale: Array) -> coal.BVHModelOBBRSS:
    return mesh_of(*read_mesh(path, where, mesh, scale))


def mesh_of(vertices: Array, faces: Indices) -> coal.BVHModelOBBRSS:
    """Triangles as coal has them."""
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(np.array(vertices)))  # coal takes no arrays that are read-only
    triangles.extend([coal.Triangle(*face) for face in faces.tolist()])
    made = coal.BVHModelOBBRSS()
    made.beginModel(len(faces), len(vertices))
    made.addSubModel(points, triangles)
    made.endModel()
    made.computeLocalAABB()
    return made
