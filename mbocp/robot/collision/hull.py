"""Convex hulls of points and of mesh files, as obstacles have them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import coal
import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp._text import shorten
from mbocp.exceptions import InvalidValue
from mbocp.meshes.parts import Indices
from mbocp.meshes.read import UNREADABLE, read_triangles
from mbocp.meshes.volume import count_open_edges, enclosed, weld

MAX_CORNERS = 5000
_MAX_EXCESS = 0.01  # of a file's volume, by which its hull may be larger without being asked for
_LEAST_VOLUME = 1e-9  # of the cube over the diagonal
_LARGEST = 1e6  # [m]


@dataclass(frozen=True, eq=False)
class Hull:
    """A convex body by its corners.

    Attributes
    ----------
    vertices : ndarray, shape (V, 3)
        Its corners, and no other points [m].
    faces : ndarray of int, shape (F, 3)
        Triangles, seen counterclockwise from outside.
    normals : ndarray, shape (F, 3)
        Of the triangles, outwards.
    volume : float
        [m^3].
    """

    vertices: Array
    faces: Indices
    normals: Array
    volume: float

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Hull) and np.array_equal(self.vertices, other.vertices)

    def __hash__(self) -> int:
        return hash(self.vertices.tobytes())

    @property
    def middle(self) -> Array:
        """Mean of its corners [m], which is inside; that of the box around it need not be."""
        return np.asarray(self.vertices.mean(axis=0))

    @property
    def shape(self) -> coal.Convex:
        """As coal has it."""
        return _convex(self)


def hull_of(points: Array, max_corners: int = MAX_CORNERS) -> Hull:
    """Convex hull of points, shape (n, 3) [m].

    Raises
    ------
    InvalidValue
        If they are not finite, have no volume between them, or too many corners.
    """
    from scipy.spatial import ConvexHull, QhullError  # slow to import, and few problems have hulls

    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
        raise InvalidValue("vertices", f"an array of shape {points.shape}", "(n, 3) with n of 4 or more [m]")
    if not (np.abs(points) <= _LARGEST).all():  # NaN, too
        raise InvalidValue("vertices", "a coordinate that is not", f"finite, up to {_LARGEST:g} m")
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    try:
        found = ConvexHull(points)
        volume = float(found.volume)
    except (QhullError, ValueError):  # flat, or one point
        volume = 0.0
    if not volume > _LEAST_VOLUME * size**3:
        raise InvalidValue(
            "vertices", "points of one plane", "corners of a body with a volume; use a thin box"
        )
    if len(found.vertices) > max_corners:
        what = f"{len(found.vertices)} corners of the hull"
        raise InvalidValue("vertices", what, f"{max_corners} at most; give a mesh of fewer triangles")
    corners = points[found.vertices]
    place = np.zeros(len(points), dtype=np.int64)
    place[found.vertices] = np.arange(len(corners))
    faces, normals = place[found.simplices], np.array(found.equations[:, :3])
    a, b, c = (corners[faces[:, k]] for k in range(3))
    is_turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), normals) < 0.0
    faces[is_turned] = faces[is_turned][:, ::-1]
    return Hull(frozen_array(corners), faces, frozen_array(normals), volume)


def hull_of_file(path: Path, scale: Array, may_be_larger: bool) -> tuple[Hull, float]:
    """Hull of a mesh file's corners, and its volume beyond the mesh's own, as a part of that.

    Parameters
    ----------
    path : Path
        STL, Collada, OBJ, or what coal reads.
    scale : ndarray, shape (3,)
        Metres of a unit of the file.
    may_be_larger : bool
        Whether the hull stands for whatever the file has; otherwise its surface has to be closed and convex.

    Returns
    -------
    hull : Hull
    excess : float
        NaN where the surface is not closed.

    Raises
    ------
    InvalidValue
        If the file is missing or cannot be read, or its surface is not closed or not convex.
    """
    name = shorten(str(path))
    try:
        vertices, faces = read_triangles(path)
    except UNREADABLE as error:
        what = f"{name}, which cannot be read: {error}"
        raise InvalidValue("file", what, "a mesh: STL, Collada, OBJ or PLY") from error
    hull = hull_of(vertices * scale)
    volume, open_edges = _measure(vertices * scale, faces)
    excess = np.nan if open_edges else hull.volume / max(volume, 1e-300) - 1.0
    if may_be_larger:
        return hull, excess
    way_out = "hull = true takes the convex hull all the same"
    if open_edges:
        what = f"{name}, whose surface is not closed: {open_edges} edges have no second triangle"
        raise InvalidValue("file", what, f"the surface of a volume, all triangles facing outwards; {way_out}")
    if abs(excess) > _MAX_EXCESS:
        volumes = f"{hull.volume:.3g} and {volume:.3g} m^3"
        what = f"{name}, which is not convex: its hull has {100 * excess:.3g} % more volume ({volumes})"
        raise InvalidValue("file", what, f"a convex body; cut it into convex parts, or {way_out}")
    return hull, excess


def _measure(vertices: Array, faces: Indices) -> tuple[float, int]:
    """Volume that triangles enclose [m^3], and how many edges have no second triangle the other way round."""
    corners, faces = weld(vertices, faces)
    return float(enclosed(corners, faces).mass), count_open_edges(faces)


@lru_cache(maxsize=64)
def _convex(hull: Hull) -> coal.Convex:
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(np.array(hull.vertices)))
    triangles.extend([coal.Triangle(*face) for face in hull.faces.tolist()])
    return coal.Convex(points, triangles)
