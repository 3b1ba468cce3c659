"""Shapes of a URDF and the paths of its meshes, drawn and solid; no mesh is read.

Pinocchio's own builder loads every mesh (seconds for some robots) and stops at the first missing one.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._text import shorten, show, warn_caller
from mbocp.exceptions import RobotFileError
from mbocp.robot.collision.geometry import LinkShape, ShapeSource
from mbocp.robot.loading.addresses import NO_PACKAGE, find_root_of_stored, resolve
from mbocp.robot.loading.readers.urdf_xml import Urdf, child_attribute, finite_numbers, pairs_disabled_beside
from mbocp.robot.warnings import MissingMeshWarning

_GREY = (0.7, 0.7, 0.72, 1.0)
_SCALE_RANGE = (1e-9, 1e9)  # of a mesh, in size; a mirror has a negative one
_MAX_LENGTH = 1e6  # [m] of a shape
_ROUND = {"sphere": coal.Sphere, "cylinder": coal.Cylinder, "capsule": coal.Capsule}


def build_visuals(urdf: Urdf, model: pin.Model, folders: Sequence[Path]) -> pin.GeometryModel:
    """Make a `pin.GeometryModel` of the shapes and mesh paths of a URDF.

    Primitive shapes are coal shapes; a mesh has `meshPath`, `meshScale` and an empty placeholder `geometry`.

    Warns
    -----
    MissingMeshWarning
        Once, naming each missing file and its link.
    """
    materials = {m.get("name"): m for m in urdf.root.iterfind("material")}
    visuals, missing = pin.GeometryModel(), []
    for link, number, visual in _elements(urdf, "visual"):
        try:
            shape = _shape(urdf, folders, "visual", link, number, visual)
        except FileNotFoundError as error:
            missing.append((str(error), link))
            continue
        if shape is not None:
            color = _color(urdf, shape.where, visual.find("material"), materials)
            visuals.addGeometryObject(object_of(model, shape, color))
    if missing:
        path = (
            urdf.path if find_root_of_stored(urdf.path.parent) is None else urdf.path.name
        )  # that of a result
        warn_caller(f"{path}: shown without its missing meshes ({_name(missing)})", MissingMeshWarning)
    return visuals


def shapes_of(urdf: Urdf, folders: Sequence[Path]) -> ShapeSource:
    """Say what a URDF has to say of the shapes of its links."""
    drawn = (link for link, _, visual in _elements(urdf, "visual") if visual.find("geometry/*") is not None)
    return ShapeSource(
        urdf.path,
        partial(link_shapes, urdf, tuple(folders), "collision"),
        partial(pairs_disabled_beside, urdf.path),
        frozenset(drawn),
    )


def mesh_addresses(root: ElementTree.Element) -> tuple[str, ...]:
    """Addresses of all meshes, each once."""
    kinds = ("visual", "collision")
    meshes = (mesh for kind in kinds for mesh in root.iterfind(f"link/{kind}/geometry/mesh"))
    return tuple(dict.fromkeys(mesh.get("filename", "") for mesh in meshes))


def link_shapes(
    urdf: Urdf, folders: Sequence[Path], kind: str, links: Collection[str] | None = None
) -> Iterator[LinkShape]:
    """Read the shapes of links.

    Parameters
    ----------
    urdf : Urdf
    folders : sequence of Path
        That hold packages of meshes.
    kind : {"collision", "visual"}
    links : collection of str, optional
        Those that are asked for; all by default.

    Raises
    ------
    RobotFileError
        If a mesh is missing, naming it and its link.
    """
    for link, number, element in _elements(urdf, kind):
        if links is not None and link not in links:
            continue
        try:
            shape = _shape(urdf, folders, kind, link, number, element)
        except FileNotFoundError as error:
            where = f"{kind} {number} of link {show(link)}"
            raise RobotFileError(urdf.path, f"{where}: its mesh is missing: {error}") from error
        if shape is not None:
            yield shape


def _elements(urdf: Urdf, kind: str) -> Iterator[tuple[str, int, ElementTree.Element]]:
    """Link, number in it, and element of each <visual> or <collision>."""
    for link in urdf.root.iterfind("link"):
        for number, element in enumerate(link.iterfind(kind)):
            yield link.get("name", ""), number, element


def _shape(
    urdf: Urdf, folders: Sequence[Path], kind: str, link: str, number: int, element: ElementTree.Element
) -> LinkShape | None:
    """Shape of a <visual> or <collision>; None if it has none."""
    geometry = element.find("geometry")
    form = None if geometry is None else next(iter(geometry), None)
    if form is None:
        return None
    where = f"{kind} {number} of link {show(link)}"
    made, mesh, scale = _form(urdf, where, form, folders)
    return LinkShape(link, number, where, made, mesh, scale, _placement(urdf, where, element))


def _form(
    urdf: Urdf, where: str, element: ElementTree.Element, folders: Sequence[Path]
) -> tuple[coal.CollisionGeometry, str, Array]:
    """Geometry, mesh path and scale of what stands in a <geometry>."""
    tag, unscaled = element.tag, np.ones(3)
    if tag == "mesh":
        path = resolve(element.get("filename", ""), urdf.path.parent, folders)
        scale = finite_numbers(urdf.path, f"{where}: mesh scale", element.get("scale"), (1.0, 1.0, 1.0))
        if not np.all((np.abs(scale) >= _SCALE_RANGE[0]) & (np.abs(scale) <= _SCALE_RANGE[1])):
            least, most = _SCALE_RANGE
            raise RobotFileError(
                urdf.path, f"{where}: mesh scale is {scale.tolist()}, expected {least:g} to {most:g} in size"
            )
        return coal.BVHModelOBBRSS(), str(path), scale
    if tag == "box":
        return coal.Box(*_sizes(urdf, f"{where}: box size", element.get("size"), 3)), "", unscaled
    if tag not in _ROUND:
        raise RobotFileError(urdf.path, f"<geometry> has the unknown shape <{shorten(tag)}>")
    keys = ("radius",) if tag == "sphere" else ("radius", "length")
    sizes = [_sizes(urdf, f"{where}: {tag} {key}", element.get(key), 1)[0] for key in keys]
    return _ROUND[tag](*map(float, sizes)), "", unscaled


def _placement(urdf: Urdf, where: str, element: ElementTree.Element) -> pin.SE3:
    """The <origin> of a <visual> or <collision> in its link."""
    rpy, xyz = (
        finite_numbers(
            urdf.path, f"{where}: origin {key}", child_attribute(element, "origin", key), (0.0,) * 3
        )
        for key in ("rpy", "xyz")
    )
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)


def _sizes(urdf: Urdf, what: str, text: str | None, count: int) -> Array:
    """Lengths that a picture can have [m]."""
    sizes = finite_numbers(urdf.path, what, text, (0.0,) * count)
    if not np.all((sizes >= 0.0) & (sizes <= _MAX_LENGTH)):
        raise RobotFileError(urdf.path, f"{what} is {show(text)}, expected 0 to {_MAX_LENGTH:g} m")
    return sizes


def object_of(model: pin.Model, shape: LinkShape, color: Array | None) -> pin.GeometryObject:
    """What draws a shape; a mesh is an empty placeholder with its path."""
    frame = model.getFrameId(shape.link, pin.FrameType.BODY)
    at, name = model.frames[frame], f"{shape.link}_{shape.number}"
    rgba = np.array(_GREY if color is None else color)
    return pin.GeometryObject(
        name,
        at.parentJoint,
        frame,
        at.placement * shape.placement,
        shape.geometry,
        shape.mesh,
        shape.scale,
        color is not None,
        rgba,
    )


def _name(missing: Sequence[tuple[str, str | None]]) -> str:
    """One mesh for each reason why meshes are missing, and how many more; packages by their names."""
    alike: dict[str, list[str]] = {}
    for told, link in missing:
        address, separator, package = told.partition(NO_PACKAGE)
        alike.setdefault(separator + package, []).append(f"link {link!r}: {address}")
    return "; ".join(
        f"{first}{reason}{f', and {len(others)} more' if others else ''}"
        for reason, (first, *others) in alike.items()
    )


def _color(
    urdf: Urdf,
    where: str,
    material: ElementTree.Element | None,
    materials: dict[str | None, ElementTree.Element],
) -> Array | None:
    if material is None:
        return None
    for candidate in (material, materials.get(material.get("name"))):
        if candidate is not None and candidate.find("color") is not None:
            text = child_attribute(candidate, "color", "rgba")
            return finite_numbers(urdf.path, f"{where}: color rgba", text, (0.7, 0.7, 0.7, 1.0))
    return None
