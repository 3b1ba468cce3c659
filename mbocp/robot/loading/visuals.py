"""Visuals of a robot: shapes of the URDF and the paths of its meshes; no mesh is read.

Pinocchio's own builder loads every mesh (seconds for some robots) and stops at the first missing one.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._files import is_file, is_folder
from mbocp._text import shortened, shown
from mbocp._warn import warn_caller
from mbocp.exceptions import RobotFileError
from mbocp.robot.loading.unpacked import unpacked_file, unpacked_root
from mbocp.robot.loading.urdf import Urdf
from mbocp.robot.loading.urdf_numbers import child_attribute, finite_numbers
from mbocp.robot.warnings import MissingMeshWarning

_GREY = (0.7, 0.7, 0.72, 1.0)
_SCHEMES = ("package://", "model://")
_SCALE_RANGE = (1e-9, 1e9)  # of a mesh, in size; a mirror has a negative one
_MAX_LENGTH = 1e6  # [m] of a shape
_ROUND = {"sphere": coal.Sphere, "cylinder": coal.Cylinder, "capsule": coal.Capsule}
_NO_PACKAGE = ": no package folder "


def build_visuals(urdf: Urdf, model: pin.Model, package_dirs: Sequence[Path]) -> pin.GeometryModel:
    """Shapes and mesh paths of a URDF, as a `pin.GeometryModel`.

    Primitive shapes are coal shapes; a mesh has `meshPath`, `meshScale` and an empty placeholder `geometry`.

    Warns
    -----
    MissingMeshWarning
        Once, naming each missing file and its link.
    """
    materials = {m.get("name"): m for m in urdf.root.iterfind("material")}
    visuals, missing = pin.GeometryModel(), []
    for link in urdf.root.iterfind("link"):
        for number, visual in enumerate(link.iterfind("visual")):
            where = f"visual {number} of link {shown(link.get('name'))}"
            try:
                shape = shape_of(urdf, where, visual, package_dirs)
            except FileNotFoundError as error:
                missing.append((str(error), link.get("name")))
                continue
            if shape is not None:
                visuals.addGeometryObject(_object(urdf, model, link, number, visual, shape, materials))
    if missing:
        path = urdf.path if unpacked_root(urdf.path.parent) is None else urdf.path.name  # that of a result
        warn_caller(
            f"{path}: shown without its missing meshes ({_named(missing)})",
            MissingMeshWarning,
        )
    return visuals


def _named(missing: Sequence[tuple[str, str | None]]) -> str:
    """One mesh for each reason why meshes are missing, and how many more; packages by their names."""
    alike: dict[str, list[str]] = {}
    for told, link in missing:
        address, separator, package = told.partition(_NO_PACKAGE)
        alike.setdefault(separator + package, []).append(f"link {link!r}: {address}")
    return "; ".join(
        f"{first}{reason}{f', and {len(others)} more' if others else ''}"
        for reason, (first, *others) in alike.items()
    )


def resolve(uri: str, base: Path, package_dirs: Iterable[Path]) -> Path:
    """File that a URDF's `uri` means: package://, model://, file://, absolute, or relative to `base`.

    A package is looked for in `package_dirs`, in ROS_PACKAGE_PATH and AMENT_PREFIX_PATH, and in the folders
    above the URDF. What was unpacked with a stored robot is where its list says.

    Raises
    ------
    FileNotFoundError
        If there is no such file; the text says what was looked for.
    """
    root = unpacked_root(base)
    if root is not None:
        return unpacked_file(root, uri, base)
    for scheme in _SCHEMES:
        if uri.startswith(scheme):
            package, _, rest = uri.removeprefix(scheme).partition("/")
            return _in_package(package, rest, uri, base, package_dirs)
    path = Path(uri.removeprefix("file://"))
    path = path if path.is_absolute() else base / path
    if not is_file(path):
        raise FileNotFoundError(f"{shortened(str(path))} does not exist")
    return path


def _in_package(package: str, rest: str, uri: str, base: Path, package_dirs: Iterable[Path]) -> Path:
    folders = [*package_dirs, *_environment_packages(), base, *base.parents]
    roots = [folder / package for folder in folders if is_folder(folder / package)]
    roots += [folder for folder in folders if folder.name == package]
    if not roots:
        raise FileNotFoundError(
            f"{shortened(uri)}{_NO_PACKAGE}{shown(package)} found, name its parent in package_dirs or "
            "--package-dir"
        )
    for root in roots:
        if is_file(root / rest):
            return root / rest
    raise FileNotFoundError(f"{shortened(uri)}: {shortened(str(roots[0] / rest))} does not exist")


def _environment_packages() -> list[Path]:
    ros = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    ament = [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    return ros + ament


def shape_of(
    urdf: Urdf, where: str, visual: ElementTree.Element, package_dirs: Sequence[Path]
) -> tuple[coal.CollisionGeometry, str, Array] | None:
    """Geometry, mesh path and scale of a <visual> or <collision>; None if it has no shape."""
    geometry = visual.find("geometry")
    element = None if geometry is None else next(iter(geometry), None)
    if element is None:
        return None
    tag, unscaled = element.tag, np.ones(3)
    if tag == "mesh":
        path = resolve(element.get("filename", ""), urdf.path.parent, package_dirs)
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
        raise RobotFileError(urdf.path, f"<geometry> has the unknown shape <{shortened(tag)}>")
    keys = ("radius",) if tag == "sphere" else ("radius", "length")
    sizes = [_sizes(urdf, f"{where}: {tag} {key}", element.get(key), 1)[0] for key in keys]
    return _ROUND[tag](*map(float, sizes)), "", unscaled


def placement_of(urdf: Urdf, where: str, element: ElementTree.Element) -> pin.SE3:
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
        raise RobotFileError(urdf.path, f"{what} is {shown(text)}, expected 0 to {_MAX_LENGTH:g} m")
    return sizes


def _object(
    urdf: Urdf,
    model: pin.Model,
    link: ElementTree.Element,
    number: int,
    visual: ElementTree.Element,
    shape: tuple[coal.CollisionGeometry, str, Array],
    materials: dict[str | None, ElementTree.Element],
) -> pin.GeometryObject:
    name = link.get("name", "")
    frame = model.getFrameId(name, pin.FrameType.BODY)
    where = f"visual {number} of link {shown(name)}"
    origin = placement_of(urdf, where, visual)
    geometry, mesh, scale = shape
    color = _color(urdf, where, visual.find("material"), materials)
    placement = model.frames[frame].placement * origin
    override = color is not None
    rgba = np.array(color if override else _GREY)
    parent = model.frames[frame].parentJoint
    return pin.GeometryObject(
        f"{name}_{number}", parent, frame, placement, geometry, mesh, scale, override, rgba
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
