"""What a robot looks like: shapes of the URDF and the paths of its meshes; no mesh is read.

Pinocchio's own builder loads every mesh (seconds for some robots) and stops at the first missing one.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.exceptions import RobotFileError
from mbocp.robot.notices import MissingMeshWarning
from mbocp.robot.urdf import Urdf

__all__ = ["build_visuals", "resolve"]

_GREY = (0.7, 0.7, 0.72, 1.0)
_SCHEMES = ("package://", "model://")
_SHOWN = 5  # missing meshes named in one warning


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
            try:
                shape = _shape(urdf, visual, package_dirs)
            except FileNotFoundError as error:
                missing.append((str(error), link.get("name")))
                continue
            if shape is not None:
                visuals.addGeometryObject(_object(model, link, number, visual, shape, materials))
    if missing:
        named = "; ".join(f"link {link!r}: {file}" for file, link in missing[:_SHOWN])
        more = f"; and {len(missing) - _SHOWN} more" if len(missing) > _SHOWN else ""
        warnings.warn(
            f"{urdf.path}: shown without its missing meshes ({named}{more})", MissingMeshWarning, stacklevel=2
        )
    return visuals


def resolve(uri: str, base: Path, package_dirs: Iterable[Path]) -> Path:
    """File that a URDF's `uri` means: package://, model://, file://, absolute, or relative to `base`.

    A package is looked for in `package_dirs`, in ROS_PACKAGE_PATH and AMENT_PREFIX_PATH, and in the folders
    above the URDF.

    Raises
    ------
    FileNotFoundError
        If there is no such file; the text says what was looked for.
    """
    for scheme in _SCHEMES:
        if uri.startswith(scheme):
            package, _, rest = uri.removeprefix(scheme).partition("/")
            return _in_package(package, rest, uri, base, package_dirs)
    path = Path(uri.removeprefix("file://"))
    path = path if path.is_absolute() else base / path
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist")
    return path


def _in_package(package: str, rest: str, uri: str, base: Path, package_dirs: Iterable[Path]) -> Path:
    folders = [*package_dirs, *_environment_packages(), base, *base.parents]
    roots = [folder / package for folder in folders if (folder / package).is_dir()]
    roots += [folder for folder in folders if folder.name == package]
    if not roots:
        raise FileNotFoundError(
            f"{uri}: no package folder {package!r} found, name its parent in package_dirs"
        )
    for root in roots:
        if (root / rest).is_file():
            return root / rest
    raise FileNotFoundError(f"{uri}: {roots[0] / rest} does not exist")


def _environment_packages() -> list[Path]:
    ros = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    ament = [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    return ros + ament


def _shape(
    urdf: Urdf, visual: ElementTree.Element, package_dirs: Sequence[Path]
) -> tuple[coal.CollisionGeometry, str, Array] | None:
    """Geometry, mesh path and scale of a <visual>; None if it has no shape."""
    geometry = visual.find("geometry")
    element = None if geometry is None else next(iter(geometry), None)
    if element is None:
        return None
    if element.tag == "mesh":
        path = resolve(element.get("filename", ""), urdf.path.parent, package_dirs)
        return coal.BVHModelOBBRSS(), str(path), _numbers(urdf, element.get("scale"), (1.0, 1.0, 1.0))
    if element.tag == "box":
        return coal.Box(*_numbers(urdf, element.get("size"), (0.0, 0.0, 0.0))), "", np.ones(3)
    radius = float(_numbers(urdf, element.get("radius"), (0.0,))[0])
    if element.tag == "sphere":
        return coal.Sphere(radius), "", np.ones(3)
    length = float(_numbers(urdf, element.get("length"), (0.0,))[0])
    if element.tag in ("cylinder", "capsule"):
        return (coal.Cylinder if element.tag == "cylinder" else coal.Capsule)(radius, length), "", np.ones(3)
    raise RobotFileError(urdf.path, f"<geometry> has the unknown shape <{element.tag}>")


def _object(
    model: pin.Model,
    link: ElementTree.Element,
    number: int,
    visual: ElementTree.Element,
    shape: tuple[coal.CollisionGeometry, str, Array],
    materials: dict[str | None, ElementTree.Element],
) -> pin.GeometryObject:
    name = link.get("name", "")
    frame = model.getFrameId(name, pin.FrameType.BODY)
    origin = pin.SE3.Identity()
    element = visual.find("origin")
    if element is not None:
        rpy = np.array([float(x) for x in element.get("rpy", "0 0 0").split()])
        xyz = np.array([float(x) for x in element.get("xyz", "0 0 0").split()])
        origin = pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)
    geometry, mesh, scale = shape
    color = _color(visual.find("material"), materials)
    placement = model.frames[frame].placement * origin
    override = color is not None
    rgba = np.array(color if override else _GREY)
    parent = model.frames[frame].parentJoint
    return pin.GeometryObject(
        f"{name}_{number}", parent, frame, placement, geometry, mesh, scale, override, rgba
    )


def _color(
    material: ElementTree.Element | None, materials: dict[str | None, ElementTree.Element]
) -> tuple[float, ...] | None:
    if material is None:
        return None
    for candidate in (material, materials.get(material.get("name"))):
        element = None if candidate is None else candidate.find("color")
        if element is not None:
            return tuple(float(x) for x in element.get("rgba", "0.7 0.7 0.7 1").split())
    return None


def _numbers(urdf: Urdf, text: str | None, default: tuple[float, ...]) -> Array:
    if text is None:
        return np.array(default)
    try:
        values = np.array([float(x) for x in text.split()])
    except ValueError as error:
        raise RobotFileError(urdf.path, f"expected numbers, got {text!r}") from error
    if values.shape != (len(default),):
        raise RobotFileError(urdf.path, f"expected {len(default)} numbers, got {text!r}")
    return values
