"""Reading an SDF, Gazebo's format: the joints of a loop that the tree does not take become constraints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mbocp.robot.loading.description import Description
from mbocp.robot.loading.inertias_table import InertiasTable
from mbocp.robot.loading.readers.sdf_joints import read_joints
from mbocp.robot.loading.readers.sdf_links import mesh_uris, read_links
from mbocp.robot.loading.readers.sdf_xml import parse_sdf
from mbocp.robot.loading.readers.tree import (
    LeftOut,
    build_tree,
    draw_tree,
    place_at_references,
    refuse_inertias,
    shapes_of_tree,
    tell_impossible,
    tell_left_out,
    tell_missing,
)
from mbocp.robot.loading.schema import tables_from


def read(
    path: Path,
    name: str,
    *,
    free_flyer: bool | None,
    mimic: bool | None,
    folders: Sequence[Path],
    inertias: InertiasTable | None = None,
) -> Description:
    """Read a robot from an SDF; joints that mimic others are coupled to them unless `mimic` is False."""
    refuse_inertias(path, inertias)
    sdf, left_out = parse_sdf(path), LeftOut()
    links = read_links(sdf, folders, left_out)
    found = read_joints(sdf, links, left_out)
    table: dict[str, Any] = {"constraint": [*found.loops, *(found.couplings if mimic is not False else ())]}
    if sdf.gravity is not None:
        table["gravity"] = sdf.gravity.tolist()
    model = build_tree(path, sdf.name, found.bodies, free_flyer)
    tell_left_out(path, left_out)
    tell_impossible(path, model)
    tell_missing(path, found.bodies)
    return Description(
        name=sdf.name,
        file=path,
        model=model,
        visuals=draw_tree(model, found.bodies),
        q0=place_at_references(model, found.bodies),
        table=tables_from(table),
        source=path,
        shapes=(shapes_of_tree(path, found.bodies),),
    )


def companions(path: Path) -> tuple[Path, ...]:
    """None: a model within it is not supported."""
    return ()


def addresses(path: Path) -> tuple[str, ...]:
    """Addresses of its meshes."""
    return mesh_uris(parse_sdf(path))


def oddities(path: Path) -> Iterator[str]:
    """Joints that cannot move, and links with the mass that Gazebo gives those that say none."""
    sdf, left_out = parse_sdf(path), LeftOut()
    for link in sdf.element.iterfind("link"):
        if link.find("inertial") is None:
            yield f"link {link.get('name')!r}: no <inertial>: it has 1 kg and 1 kg m^2 about each axis"
    links = read_links(sdf, (), left_out)
    for joint in (joint for body in read_joints(sdf, links, left_out).bodies for joint in body.joints):
        if joint.lower >= joint.upper:
            yield f"joint {joint.name!r}: its limits {joint.lower:g} ... {joint.upper:g} leave it no range"
