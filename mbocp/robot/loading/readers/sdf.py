"""Reading an SDF, Gazebo's format: the joints of a loop that the tree does not take become constraints."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mbocp.robot.loading.description import Description, Reading
from mbocp.robot.loading.readers.sdf_joints import read_joints
from mbocp.robot.loading.readers.sdf_links import mesh_uris, read_links
from mbocp.robot.loading.readers.sdf_xml import parse_sdf
from mbocp.robot.loading.readers.tree import LeftOut, describe_tree, oddities_of
from mbocp.robot.loading.schema import tables_from


def read(path: Path, name: str, how: Reading) -> Description:
    """Read a robot from an SDF; joints that mimic others are coupled to them unless `mimic` is False."""
    sdf, left_out = parse_sdf(path), LeftOut()
    links = read_links(sdf, how.folders, left_out)
    found = read_joints(sdf, links, left_out)
    couplings = [] if how.mimic is False else found.couplings
    table: dict[str, Any] = {"constraint": [*found.loops, *couplings]}
    if sdf.gravity is not None:
        table["gravity"] = sdf.gravity.tolist()
    return describe_tree(path, sdf.name, found.bodies, tables_from(table), left_out, how)


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
    yield from oddities_of(read_joints(sdf, links, left_out).bodies)
