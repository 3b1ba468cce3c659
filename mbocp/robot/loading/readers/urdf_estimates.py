"""Masses and inertias of links for which a URDF has none, from their shapes; they become part of the URDF.

The density is uniform. A surface that is not closed counts as its convex hull.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._text import quote_all, show, warn_caller
from mbocp.exceptions import InvalidValue, RobotFileError, suggest
from mbocp.meshes.mesh_parts import Indices, count_open_edges, fill, measure_enclosed_body, scale_mass, weld
from mbocp.robot.collision.geometry import LinkShape, read_mesh
from mbocp.robot.collision.hull import hull_of
from mbocp.robot.loading.readers.urdf_inertia import Inertial, fault_of, is_rotor, read_inertials
from mbocp.robot.loading.readers.urdf_shapes import link_shapes
from mbocp.robot.loading.readers.urdf_xml import Urdf
from mbocp.robot.loading.robot_tables import InertiasTable, LinkTable
from mbocp.robot.payload import INERTIA_KEYS, LinkInertia, Payload
from mbocp.robot.warnings import EstimatedInertiaWarning

_KINDS = ("collision", "visual")  # of shapes, the better ones first
_LEAST_SHARE = 1e-6  # volume of a mesh, of its hull's: less is the noise of a surface that encloses nothing
_LARGEST_SHARE = 1.02  # and the most; also of a moment of inertia, of the sum of the other two


class _SolidLink(NamedTuple):
    """A link's shapes, filled evenly.

    Attributes
    ----------
    body : pin.Inertia
        Of 1 kg/m^3, in the axes of the link.
    origin : str
        Which shapes they are.
    """

    body: pin.Inertia
    origin: str


def with_inertias(
    urdf: Urdf, asked: InertiasTable, folders: Sequence[Path]
) -> tuple[Urdf, tuple[LinkInertia, ...]]:
    """Return the URDF with inertias for links that have none, and these.

    Links that have none are those with shapes and without an ``<inertial>``, or with one of zeros. A link of
    which the file gives a mass, and no inertia or an impossible one, keeps the mass.

    Parameters
    ----------
    urdf : Urdf
    asked : InertiasTable
    folders : sequence of Path
        That hold packages of meshes.

    Raises
    ------
    RobotFileError
        For a link that does not exist, a mesh that cannot be read, and a mass that the links exceed.

    Warns
    -----
    EstimatedInertiaWarning
        Once, with each link, its mass and where that is from.
    """
    given = _read_tables_given(urdf, asked)
    inertials = {inertial.link: inertial for inertial in read_inertials(urdf.path, urdf.root)}
    faults = {} if asked.density is asked.mass is None else _faults(urdf, inertials, given)
    partial = [link for link, table in given.items() if not table.is_whole]
    filled = _fill(urdf, folders, [*faults, *partial])
    found = {link: _of_table(urdf, link, table, filled.get(link)) for link, table in given.items()}
    usable = {link: each for link, each in filled.items() if link in faults and each.body.mass > 0.0}
    masses = {link: inertials[link].mass for link in usable if link in inertials and inertials[link].mass > 0}
    density = _density(urdf, asked, inertials, found, usable, masses)
    for link, each in usable.items():
        mass = masses.get(link, density * each.body.mass)
        why = f"{faults[link]}: its mass is kept; {each.origin}" if link in masses else each.origin
        found[link] = LinkInertia.of(link, scale_mass(each.body, mass), why)
    _tell(urdf, asked, density, found, [link for link in filled if link in faults and link not in usable])
    return _write_inertias(urdf, found), tuple(found.values())


def _read_tables_given(urdf: Urdf, asked: InertiasTable) -> Mapping[str, LinkTable]:
    names = [link.get("name", "") for link in urdf.root.iterfind("link")]
    given: dict[str, LinkTable] = asked.links
    for name in given:
        if name not in names:
            reason = f"the robot has no link {show(name)}; {suggest(name, names)}"
            raise RobotFileError(urdf.path, reason, "inertias.links")
    return given


def _faults(urdf: Urdf, inertials: Mapping[str, Inertial], given: Mapping[str, LinkTable]) -> dict[str, str]:
    """Links that need an inertia, and what is wrong with the one that they have."""
    found = {}
    for element in urdf.root.iterfind("link"):
        link = element.get("name", "")
        inertial = inertials.get(link)
        if link in given or (inertial is not None and is_rotor(inertial)):
            continue
        fault = "has no inertial" if inertial is None else fault_of(inertial)
        if fault:
            found[link] = fault
    return found


def _fill(urdf: Urdf, folders: Sequence[Path], links: Iterable[str]) -> dict[str, _SolidLink]:
    """Fill the shapes of links; links without any are left out."""
    found: dict[str, _SolidLink] = {}
    for kind in _KINDS:
        missing = frozenset(links) - set(found)
        shapes: dict[str, list[LinkShape]] = {}
        for shape in link_shapes(urdf, folders, kind, missing) if missing else ():
            shapes.setdefault(shape.link, []).append(shape)
        for link, several in shapes.items():
            found[link] = _fill_shapes(urdf.path, kind, several)
    return found


def _fill_shapes(path: Path, kind: str, shapes: Sequence[LinkShape]) -> _SolidLink:
    whole, hulls = pin.Inertia.Zero(), 0
    for shape in shapes:
        if shape.mesh:
            body, is_hull = _of_mesh(*read_mesh(path, shape.where, Path(shape.mesh), shape.scale))
            hulls += is_hull
        else:
            body = fill(shape.geometry)
        if body.mass > 0.0:
            whole = whole + shape.placement.act(body)
    told = f", {hulls} open {'mesh' if hulls == 1 else 'meshes'} by the convex hull" if hulls else ""
    return _SolidLink(whole, f"{kind} shapes{told}")


def _of_mesh(vertices: Array, faces: Indices) -> tuple[pin.Inertia, bool]:
    """Body of 1 kg/m^3 within a mesh, and whether it is that within the convex hull."""
    corners, triangles = weld(vertices, faces)
    try:
        hull = hull_of(corners, max_corners=len(corners))
    except InvalidValue:  # flat
        return pin.Inertia.Zero(), True
    if not count_open_edges(triangles):
        body = measure_enclosed_body(corners, triangles)
        # Faces that are there twice may leave no volume, or more than there is room for.
        if _LEAST_SHARE * hull.volume < body.mass <= _LARGEST_SHARE * hull.volume and _is_possible(body):
            return body, False
    return measure_enclosed_body(np.array(hull.vertices), hull.faces), True


def _is_possible(body: pin.Inertia) -> bool:
    """Whether a body may have these moments; those of a surface that runs through itself may be none."""
    low, middle, high = np.linalg.eigvalsh(np.asarray(body.inertia))
    return bool(low > 0.0 and high <= _LARGEST_SHARE * (low + middle))


def _of_table(urdf: Urdf, link: str, table: LinkTable, filled: _SolidLink | None) -> LinkInertia:
    """What is given of a link, and the rest by its shapes."""
    if not table.is_whole and (filled is None or not filled.body.mass > 0.0):
        missing = " and ".join(key for key in ("com", "inertia") if getattr(table, key) is None)
        reason = f"the link has no shape with a volume; give {missing}, too"
        raise RobotFileError(urdf.path, reason, f"inertias.links: {link}")
    said = Payload(name=link, frame=link, **table.model_dump(exclude_none=True))
    com, inertia, origin = np.array(said.com), said.inertia_matrix, "given"
    if filled is not None:
        body = scale_mass(filled.body, table.mass)
        com = np.asarray(body.lever) if table.com is None else com
        inertia = np.asarray(body.inertia) if table.inertia is None else inertia
        origin = f"given mass; {filled.origin}"
    return LinkInertia.of(link, pin.Inertia(table.mass, com, inertia), origin)


def _density(
    urdf: Urdf,
    asked: InertiasTable,
    inertials: Mapping[str, Inertial],
    found: Mapping[str, LinkInertia],
    usable: Mapping[str, _SolidLink],
    masses: Mapping[str, float],
) -> float:
    """Density of the links without a mass [kg/m^3]; zero if there are none."""
    volume = math.fsum(each.body.mass for link, each in usable.items() if link not in masses)
    if volume == 0.0 or asked.mass is None:
        return asked.density or 0.0
    known = [one.mass for one in found.values()] + [
        inertial.mass for link, inertial in inertials.items() if link not in found
    ]
    if not asked.mass > math.fsum(known):
        reason = (
            f"got {asked.mass:g} kg for the whole robot, but the links with a mass of their own weigh "
            f"{math.fsum(known):g} kg"
        )
        raise RobotFileError(urdf.path, reason, "inertias.mass")
    return (asked.mass - math.fsum(known)) / volume


def _tell(
    urdf: Urdf, asked: InertiasTable, density: float, found: Mapping[str, LinkInertia], flat: Sequence[str]
) -> None:
    estimated = [one for one in found.values() if one.origin != "given"]
    if asked.density is asked.mass is None and not estimated:
        return
    if not estimated and not flat:
        words = "inertias: every link with a shape has an inertia of its own, so nothing is estimated"
        warn_caller(f"{urdf.path}: {words}", EstimatedInertiaWarning)
        return
    links = [f"link {show(one.link)} {one.mass:.3g} kg ({one.origin})" for one in estimated]
    at = f" at {density:.4g} kg/m^3" if density else ""
    words = f"inertias estimated{at}: {', '.join(links)}" if links else "inertias: none estimated"
    empty = f"; no volume in the shapes of {quote_all(flat)}" if flat else ""
    warn_caller(f"{urdf.path}: {words}{empty}", EstimatedInertiaWarning)


def _write_inertias(urdf: Urdf, found: Mapping[str, LinkInertia]) -> Urdf:
    """The URDF with these inertias in it."""
    if not found:
        return urdf
    root = deepcopy(urdf.root)
    for link in root.iterfind("link"):
        one = found.get(link.get("name", ""))
        if one is None:
            continue
        for old in link.findall("inertial"):
            link.remove(old)
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "origin", xyz=" ".join(map(repr, one.com)), rpy="0 0 0")
        ElementTree.SubElement(inertial, "mass", value=repr(one.mass))
        moments = dict(zip(INERTIA_KEYS, map(repr, one.inertia), strict=True))
        ElementTree.SubElement(inertial, "inertia", moments)
    return Urdf(urdf.path, ElementTree.tostring(root, encoding="unicode"), root)
