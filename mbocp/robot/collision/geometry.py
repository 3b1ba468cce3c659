"""Collision geometry of a robot as a `pin.GeometryModel`: shapes of the URDF, meshes read within our limits.

Pinocchio's own builder hands mesh files to assimp, whatever they are; these are read as those of a replay
are, see `mbocp.meshes`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._text import shortened, shown
from mbocp.exceptions import RobotFileError
from mbocp.meshes.parts import Indices
from mbocp.meshes.read import UNREADABLE, read_triangles
from mbocp.robot.collision.source import CollisionSource
from mbocp.robot.loading.visuals import placement_of, shape_of
from mbocp.robot.payload import SHAPES, Payload, shape_name

MAX_TRIANGLES = 1_000_000  # of all meshes of a robot; the largest that we know has 60,000
_MAX_SIZE = 1e6  # [m] of a mesh
_MIN_LENGTH = 1e-6  # [m] of a shape


def read_geometry(
    model: pin.Model,
    sources: Sequence[CollisionSource],
    payloads: Sequence[Payload] = (),
    visuals: pin.GeometryModel | None = None,
) -> pin.GeometryModel:
    """Shapes that the links of a robot collide with, in the frames of their joints.

    Parameters
    ----------
    model : pin.Model
        After locking; links are found in it by name.
    sources : sequence of CollisionSource
    payloads : sequence of Payload
        Those with a shape collide, too.
    visuals : pin.GeometryModel, optional
        Has the shapes of payloads.

    Returns
    -------
    pin.GeometryModel
        Meshes are `coal.BVHModelOBBRSS`. Empty if the URDF has no <collision>.

    Raises
    ------
    RobotFileError
        If a mesh is missing or cannot be read, or a shape has no size.
    """
    geometry = pin.GeometryModel()
    count = 0
    for source in sources:
        for link, number, element in _elements(source):
            added = _object(model, source, link, number, element)
            if added is None:
                continue
            count += getattr(added.geometry, "num_tris", 0)
            if count > MAX_TRIANGLES:
                reason = f"its collision meshes have more than {MAX_TRIANGLES} triangles; give simpler ones"
                raise RobotFileError(source.urdf.path, reason)
            geometry.addGeometryObject(added)
    drawn = {} if visuals is None else {shape.name: shape for shape in visuals.geometryObjects}
    for payload in payloads:
        if any(getattr(payload, key) is not None for key in SHAPES):
            geometry.addGeometryObject(pin.GeometryObject(drawn[shape_name(payload)]))
    return geometry


def triangles_of(mesh: coal.BVHModelBase) -> tuple[Array, Indices]:
    """Corners, shape (V, 3) [m], and triangles, shape (F, 3), of a mesh."""
    corners = [mesh.tri_indices(k) for k in range(mesh.num_tris)]
    faces = np.array([[corner[0], corner[1], corner[2]] for corner in corners], dtype=np.int64)
    return np.array(mesh.vertices(), dtype=np.float64), faces


def _elements(source: CollisionSource) -> Iterator[tuple[str, int, ElementTree.Element]]:
    for link in source.urdf.root.iterfind("link"):
        for number, element in enumerate(link.iterfind("collision")):
            yield link.get("name", ""), number, element


def _object(
    model: pin.Model, source: CollisionSource, link: str, number: int, element: ElementTree.Element
) -> pin.GeometryObject | None:
    urdf, where = source.urdf, f"collision {number} of link {shown(link)}"
    try:
        found = shape_of(urdf, where, element, source.folders)
    except FileNotFoundError as error:
        raise RobotFileError(urdf.path, f"{where}: its mesh is missing: {error}") from error
    if found is None:
        return None
    shape, mesh, scale = found
    _check_size(urdf.path, where, shape)
    if mesh:
        shape = _mesh(urdf.path, where, Path(mesh), scale)
    if not model.existFrame(source.prefix + link, pin.FrameType.BODY):
        raise RobotFileError(urdf.path, f"{where}: the robot's model has no body of this name")
    frame = model.getFrameId(source.prefix + link, pin.FrameType.BODY)
    at = model.frames[frame]
    placement = at.placement * placement_of(urdf, where, element)
    return pin.GeometryObject(
        f"{source.prefix}{link}_{number}", at.parentJoint, frame, placement, shape, mesh, np.ones(3)
    )


def _check_size(path: Path, where: str, shape: coal.CollisionGeometry) -> None:
    sizes = [
        *(getattr(shape, key) for key in ("radius", "halfLength") if hasattr(shape, key)),
        *(np.asarray(shape.halfSide) if hasattr(shape, "halfSide") else ()),
    ]
    if sizes and min(sizes) < _MIN_LENGTH:
        raise RobotFileError(path, f"{where}: a length of {min(sizes):g} m, expected {_MIN_LENGTH:g} or more")


def _mesh(path: Path, where: str, mesh: Path, scale: Array) -> coal.BVHModelOBBRSS:
    try:
        vertices, faces = read_triangles(mesh)
    except UNREADABLE as error:
        reason = f"{where}: mesh {shortened(str(mesh))} cannot be read: {error}"
        raise RobotFileError(path, reason) from error
    vertices = vertices * scale
    if np.abs(vertices).max() > _MAX_SIZE or len(faces) > MAX_TRIANGLES:
        reason = f"{where}: mesh {shortened(str(mesh))} is larger than {_MAX_SIZE:g} m, or has more than"
        raise RobotFileError(path, f"{reason} {MAX_TRIANGLES} triangles")
    if not np.ptp(vertices, axis=0).max() >= _MIN_LENGTH:
        raise RobotFileError(path, f"{where}: mesh {shortened(str(mesh))} has no extent")
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(vertices))
    triangles.extend([coal.Triangle(*face) for face in faces.tolist()])
    made = coal.BVHModelOBBRSS()
    made.beginModel(len(faces), len(vertices))
    made.addSubModel(points, triangles)
    made.endModel()
    made.computeLocalAABB()
    return made
