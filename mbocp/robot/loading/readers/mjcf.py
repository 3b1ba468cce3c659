"""Reading an MJCF, MuJoCo's format: bodies, joints, motors, loops and a pose; what is left out is told."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from mbocp.robot.loading.description import Description, Reading
from mbocp.robot.loading.readers.mjcf_bodies import read_bodies
from mbocp.robot.loading.readers.mjcf_geoms import mesh_assets
from mbocp.robot.loading.readers.mjcf_tables import disabled_pairs, read_tables
from mbocp.robot.loading.readers.mjcf_xml import parse_mjcf
from mbocp.robot.loading.readers.tree import describe_tree, oddities_of


def read(path: Path, name: str, how: Reading) -> Description:
    """Read a robot from an MJCF; it has no mimic joints, but couplings, whatever `mimic` is."""
    mjcf = parse_mjcf(path)
    found = read_bodies(mjcf, how.folders)
    table = read_tables(mjcf, found, how.free_flyer)
    disabled = partial(disabled_pairs, mjcf)
    return describe_tree(path, mjcf.name, found.bodies, table, found.left_out, how, disabled)


def companions(path: Path) -> tuple[Path, ...]:
    """The files that it includes."""
    return parse_mjcf(path).includes


def addresses(path: Path) -> tuple[str, ...]:
    """Addresses of its meshes."""
    return tuple(dict.fromkeys(mesh.address for mesh in mesh_assets(parse_mjcf(path)).values()))


def oddities(path: Path) -> Iterator[str]:
    """Joints that cannot move: MuJoCo refuses most of what else is odd."""
    return oddities_of(read_bodies(parse_mjcf(path), ()).bodies)
