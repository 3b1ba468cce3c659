"""Reading an MJCF, MuJoCo's format: bodies, joints, motors, loops and a pose; what is left out is told."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from mbocp.robot.loading.description import Description
from mbocp.robot.loading.inertias_table import InertiasTable
from mbocp.robot.loading.readers.mjcf_bodies import read_bodies
from mbocp.robot.loading.readers.mjcf_geoms import mesh_assets
from mbocp.robot.loading.readers.mjcf_tables import disabled_pairs, read_tables
from mbocp.robot.loading.readers.mjcf_xml import Mjcf, parse_mjcf
from mbocp.robot.loading.readers.tree import (
    TreeJoint,
    build_tree,
    draw_tree,
    place_at_references,
    refuse_inertias,
    shapes_of_tree,
    tell_impossible,
    tell_left_out,
    tell_missing,
)


def read(
    path: Path,
    name: str,
    *,
    free_flyer: bool | None,
    mimic: bool | None,
    folders: Sequence[Path],
    inertias: InertiasTable | None = None,
) -> Description:
    """Read a robot from an MJCF; it has no mimic joints, but couplings, whatever `mimic` is."""
    refuse_inertias(path, inertias)
    mjcf = parse_mjcf(path)
    found = read_bodies(mjcf, folders)
    table = read_tables(mjcf, found, free_flyer)
    model = build_tree(path, mjcf.name, found.bodies, free_flyer)
    tell_left_out(path, found.left_out)
    tell_impossible(path, model)
    tell_missing(path, found.bodies)
    return Description(
        name=mjcf.name,
        file=path,
        model=model,
        visuals=draw_tree(model, found.bodies),
        q0=place_at_references(model, found.bodies),
        table=table,
        source=path,
        shapes=(shapes_of_tree(path, found.bodies, partial(disabled_pairs, mjcf)),),
    )


def companions(path: Path) -> tuple[Path, ...]:
    """The files that it includes."""
    return parse_mjcf(path).includes


def addresses(path: Path) -> tuple[str, ...]:
    """Addresses of its meshes."""
    return tuple(dict.fromkeys(mesh.address for mesh in mesh_assets(parse_mjcf(path)).values()))


def oddities(path: Path) -> Iterator[str]:
    """Joints that cannot move: MuJoCo refuses most of what else is odd."""
    for joint in _joints(parse_mjcf(path)):
        if joint.lower >= joint.upper:
            yield f"joint {joint.name!r}: its limits {joint.lower:g} ... {joint.upper:g} leave it no range"


def _joints(mjcf: Mjcf) -> Iterator[TreeJoint]:
    for body in read_bodies(mjcf, ()).bodies:
        yield from body.joints
