"""Geoms of an MJCF: shapes, and the inertias that follow from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._text import show
from mbocp.exceptions import InvalidValue, RobotFileError
from mbocp.meshes.mesh_parts import Indices, fill, measure_enclosed_body, scale_mass
from mbocp.meshes.triangles import UNREADABLE, read_triangles
from mbocp.robot.collision.geometry import LinkShape, mesh_of
from mbocp.robot.collision.hull import hull_of
from mbocp.robot.loading.addresses import resolve
from mbocp.robot.loading.readers.mjcf_xml import Mjcf, XmlElement, turn_to
from mbocp.robot.loading.readers.tree import TreeShape

_DENSITY = 1000.0  # [kg/m^3]
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}
_WITHOUT_BODY = ("plane", "hfield", "sdf")
_LAST_DRAWN = 2  # group that MuJoCo's viewers show
_MESH_INERTIAS = ("legacy", "exact")
_NO_VOLUME = 1e-15  # [m^3]


class MeshAsset(NamedTuple):
    """A mesh by its address in a file, or its triangles; its scale; how its inertia is worked out."""

    address: str
    scale: Array
    inertia: str
    triangles: tuple[Array, Indices] | None = None

    def read(self, node: XmlElement, folders: Sequence[Path]) -> tuple[Array, Indices]:
        """Corners, shape (V, 3) [m], and triangles, shape (F, 3); raises `UNREADABLE`."""
        if self.triangles is None:
            points, triangles = read_triangles(resolve(self.address, node.path.parent, folders))
        else:
            points, triangles = self.triangles
        return points * self.scale, triangles


class Geom(NamedTuple):
    """A geom: its type, its sizes (half lengths) [m], its placement in the body."""

    node: XmlElement
    kind: str
    sizes: Array
    placement: pin.SE3
    mesh: MeshAsset | None

    @property
    def is_solid(self) -> bool:
        """Whether it may collide."""
        return bool(self.node.number("contype", 1.0) or self.node.number("conaffinity", 1.0))


def mesh_assets(mjcf: Mjcf) -> dict[str, MeshAsset]:
    """Meshes of an MJCF by name."""
    folder = mjcf.compiler.get("meshdir", mjcf.compiler.get("assetdir", ""))
    found: dict[str, MeshAsset] = {}
    for element in mjcf.each("asset"):
        if element.tag != "mesh" or not {"file", "vertex"} & element.attrib.keys():
            continue
        node = mjcf.node(element)
        file = node.text("file")
        name = node.text("name", Path(file).stem)
        if mjcf.compiler.get("strippath", "false") == "true":
            file = Path(file).name
        is_whole = not file or Path(file).is_absolute() or not folder
        address = file if is_whole else f"{folder.rstrip('/')}/{file}"
        if np.any(node.three("refpos")) or np.any(node.vector("refquat", (1.0, 0.0, 0.0, 0.0), 4)[1:]):
            raise RobotFileError(node.path, f"{node.where}: refpos and refquat are not supported")
        inertia = node.text("inertia", "legacy")
        triangles = None if file else _mesh_in_file(node)
        found[name] = MeshAsset(address, node.three("scale", (1.0, 1.0, 1.0)), inertia, triangles)
    return found


def _mesh_in_file(node: XmlElement) -> tuple[Array, Indices]:
    """Corners and triangles of a mesh that the file itself has; without `face` those of the hull."""
    points, corners = node.vector("vertex", None), node.vector("face", None)
    places = corners.astype(np.int64)
    count = len(points) // 3
    if len(points) % 3 or len(places) % 3 or np.any((places != corners) | (places < 0) | (places >= count)):
        words = "vertex has three numbers for each corner, face three places in it, from 0, for each triangle"
        raise RobotFileError(node.path, f"{node.where}: {words}")
    if len(places):
        return points.reshape(-1, 3), places.reshape(-1, 3)
    try:
        hull = hull_of(points.reshape(-1, 3), count)
    except InvalidValue as error:
        raise RobotFileError(node.path, f"{node.where}: {error}") from error
    return hull.vertices, hull.faces


def read_geom(node: XmlElement, meshes: Mapping[str, MeshAsset], frame: pin.SE3) -> Geom | None:
    """Read a geom; None if it has no body: planes, height fields.

    Raises
    ------
    RobotFileError
        For an unknown type or mesh, and for sizes that are missing.
    """
    kind = node.text("type", "sphere")
    if "mesh" in node.said and kind != "mesh":  # a primitive that MuJoCo fits around a mesh
        raise RobotFileError(node.path, f"{node.where}: type {kind!r} fitted to a mesh is not supported")
    if kind in _WITHOUT_BODY:
        return None
    if kind == "mesh":
        name = node.text("mesh")
        if name not in meshes:
            raise RobotFileError(node.path, f"{node.where}: there is no mesh {show(name)}")
        return Geom(node, kind, np.zeros(0), frame * node.placement, meshes[name])
    if kind not in _SIZES:
        raise RobotFileError(node.path, f"{node.where}: unknown type {show(kind)}")
    size, placement = node.vector("size", None), node.placement
    if "fromto" in node.said and _SIZES[kind] > 1:
        ends = node.vector("fromto", None, 6)
        across = ends[:3] - ends[3:6]  # z from the second to the first, as MuJoCo turns a box
        half = float(np.linalg.norm(across)) / 2.0
        if not half:
            raise RobotFileError(node.path, f"{node.where}: fromto has twice the same point")
        placement = pin.SE3(turn_to(across / (2.0 * half)), (ends[:3] + ends[3:6]) / 2.0)
        size = (
            np.array([size[0], half] if _SIZES[kind] == 2 else [size[0], size[0], half])
            if len(size)
            else size
        )
    if len(size) < _SIZES[kind] or not np.all(size[: _SIZES[kind]] > 0.0):
        words = f"size is {show(node.text('size'))}, expected {_SIZES[kind]} positive numbers"
        raise RobotFileError(node.path, f"{node.where}: {words}")
    return Geom(node, kind, size[: _SIZES[kind]], frame * placement, None)


def inertia_of(geom: Geom, folders: Sequence[Path]) -> pin.Inertia:
    """Inertia in the body, from mass or density.

    Raises
    ------
    RobotFileError
        For a mesh that is missing or encloses no volume.
    """
    node = geom.node
    mass, density = (
        node.number(key, default) for key, default in (("mass", math.nan), ("density", _DENSITY))
    )
    if mass < 0.0 or density < 0.0:
        raise RobotFileError(node.path, f"{node.where}: its mass or density is negative")
    if mass == 0.0 or (math.isnan(mass) and density == 0.0):
        return pin.Inertia.Zero()
    if node.text("shellinertia", "false") == "true":
        raise RobotFileError(node.path, f"{node.where}: shellinertia is not supported; write <inertial>")
    if geom.mesh is not None:
        body = _of_mesh(geom, geom.mesh, folders)
    else:
        body = fill(_SHAPES[geom.kind](geom.sizes))
    return geom.placement.act(scale_mass(body, density * body.mass if math.isnan(mass) else mass))


def shape_of(
    geom: Geom, body: str, number: int, colors: Mapping[str, Array], folders: Sequence[Path]
) -> TreeShape:
    """What is drawn, and what may collide.

    Raises
    ------
    FileNotFoundError
        If a mesh is missing.
    """
    node, unscaled = geom.node, np.ones(3)
    where = f"{node.where} of body {show(body)}"
    mesh, scale = "", unscaled
    if geom.mesh is not None:
        made: coal.CollisionGeometry = coal.BVHModelOBBRSS()
        if geom.mesh.triangles:
            made = mesh_of(*geom.mesh.read(node, folders))
        else:
            mesh, scale = str(resolve(geom.mesh.address, node.path.parent, folders)), geom.mesh.scale
    else:
        made = _SHAPES[geom.kind](geom.sizes)
    shape = LinkShape(body, number, where, made, mesh, scale, geom.placement)
    color = node.vector("rgba", None, 4) if "rgba" in node.said else colors.get(node.text("material"))
    return TreeShape(shape, color, node.number("group", 0.0) <= _LAST_DRAWN, geom.is_solid)


def materials_of(mjcf: Mjcf) -> dict[str, Array]:
    """Colours of materials by name."""
    nodes = [mjcf.node(element) for element in mjcf.each("asset") if element.tag == "material"]
    return {node.text("name"): node.vector("rgba", (1.0, 1.0, 1.0, 1.0)) for node in nodes}


_SHAPES: Mapping[str, Callable[[Array], coal.CollisionGeometry]] = {
    "sphere": lambda s: coal.Sphere(float(s[0])),
    "capsule": lambda s: coal.Capsule(float(s[0]), 2.0 * float(s[1])),
    "cylinder": lambda s: coal.Cylinder(float(s[0]), 2.0 * float(s[1])),
    "box": lambda s: coal.Box(*(2.0 * s)),
    "ellipsoid": lambda s: coal.Ellipsoid(*s),
}


def _of_mesh(geom: Geom, mesh: MeshAsset, folders: Sequence[Path]) -> pin.Inertia:
    """Body of 1 kg/m^3 within a mesh."""
    node = geom.node
    if mesh.inertia not in _MESH_INERTIAS:
        words = f"its mesh has inertia {show(mesh.inertia)}, expected one of {', '.join(_MESH_INERTIAS)}"
        raise RobotFileError(node.path, f"{node.where}: {words}; or write <inertial>")
    try:
        vertices, faces = mesh.read(node, folders)
    except UNREADABLE as error:
        words = "its body has no <inertial>, and the mesh that its mass follows from cannot be read"
        raise RobotFileError(node.path, f"{node.where}: {words}: {error}") from error
    if mesh.inertia == "exact":
        body = measure_enclosed_body(vertices, faces)
    else:  # MuJoCo's "legacy": volumes without sign, which holds for meshes that are not quite closed
        centre = measure_enclosed_body(vertices, faces, _middle(vertices[faces])).lever
        found = measure_enclosed_body(vertices, faces, centre)
        about_centre = pin.SE3(np.eye(3), centre).actInv(found).matrix()[3:, 3:]
        body = pin.Inertia(found.mass, centre, about_centre)
    if body.mass <= _NO_VOLUME:
        raise RobotFileError(node.path, f"{node.where}: its mesh encloses no volume; write <inertial>")
    return body


def _middle(corners: Array) -> Array:
    """Centre of the surface."""
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if not areas.sum():
        return np.zeros(3)
    return areas @ corners.mean(axis=1) / areas.sum()
