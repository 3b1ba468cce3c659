"""Bodies of meshes, as obstacles have them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mbocp._arrays import Array
from mbocp._text import shorten
from mbocp.exceptions import InvalidValue
from mbocp.meshes.mesh_parts import Indices, count_open_edges, measure_enclosed_body, weld
from mbocp.meshes.triangles import UNREADABLE, read_triangles
from mbocp.robot.collision.compound import CONCAVITY, Compound, compound_of
from mbocp.robot.collision.hull import Hull, hull_of

_MAX_EXCESS = 0.01  # of a file's volume, by which its hull may be larger and stand for it


def body_of_file(
    path: Path, scale: Array, takes_hull: bool, concavity: float = CONCAVITY
) -> tuple[Hull | Compound, float]:
    """What a mesh file encloses, and the volume of a hull beyond the mesh's own, as a part of that.

    Parameters
    ----------
    path : Path
        STL, Collada, OBJ, or what coal reads.
    scale : ndarray, shape (3,)
        Metres of a unit of the file.
    takes_hull : bool
        Whether the hull of all corners stands for whatever the file has.
    concavity : float
        See `compound_of`.

    Returns
    -------
    body : Hull or Compound
        A compound where the mesh is not convex.
    excess : float
        NaN where the surface is not closed.

    Raises
    ------
    InvalidValue
        If the file is missing or cannot be read, its surface is not closed, or it cannot be cut.
    """
    name = shorten(str(path))
    try:
        vertices, faces = read_triangles(path)
    except UNREADABLE as error:
        what = f"{name}, which cannot be read: {error}"
        raise InvalidValue("file", what, "a mesh: STL, Collada, OBJ or PLY") from error
    return body_of(vertices * scale, faces, takes_hull, concavity, name)


def body_of(
    vertices: Array, faces: Indices, takes_hull: bool, concavity: float, name: str
) -> tuple[Hull | Compound, float]:
    """What triangles enclose; see `body_of_file`, `name` is for messages."""
    hull = hull_of(vertices)
    corners, faces = weld(vertices, faces)
    open_edges = count_open_edges(faces)
    volume = np.nan if open_edges else max(float(measure_enclosed_body(corners, faces).mass), 1e-300)
    excess = hull.volume / volume - 1.0
    if takes_hull or abs(excess) <= _MAX_EXCESS:
        return hull, excess
    if open_edges:
        what = f"{name}, whose surface is not closed: {open_edges} edges have no second triangle"
        way_out = "hull = true takes the convex hull all the same"
        raise InvalidValue("file", what, f"the surface of a volume, all triangles facing outwards; {way_out}")
    return compound_of(corners, faces, concavity), 0.0
