r"""Parts of meshes, and the volumes that they enclose.

Each triangle (a, b, c) is the base of a tetrahedron whose apex is the origin. With
:math:`d = a \cdot (b \times c)` and :math:`s = a + b + c`, the integrals of 1, x and :math:`x x^T` over it
are :math:`d/6`, :math:`d s/24` and :math:`d (s s^T + a a^T + b b^T + c c^T)/120`. What lies outside of the
body counts as often with either sign of d.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbocp._arrays import Array, dataclass
from mbocp._files import MEGABYTE

Indices = NDArray[np.int64]

MESH_LIMIT = 64 * MEGABYTE  # of one mesh file [bytes]; the largest that we know has 29 MB
MAX_TRIANGLES = 10_000_000  # of one mesh, each as often as the file's scene shows it
_MAX_COORDINATE = 1e9  # of a coordinate, in the mesh's own unit
_GREY = (0.8, 0.8, 0.8)


@dataclass(frozen=True)
class Surface:
    """Diffuse colour (red, green, blue in 0..1) and, if it has one, the picture on it."""

    colour: tuple[float, float, float]
    image: Path | None = None


@dataclass(frozen=True)
class MeshPart:
    """Triangles with one surface.

    Attributes
    ----------
    vertices : ndarray, shape (V, 3)
    faces : ndarray of int, shape (F, 3)
    normals : ndarray, shape (V, 3), or None
    uvs : ndarray, shape (V, 2), or None
        Texture coordinates.
    surface : Surface or None
        None if the file gives no material.
    """

    vertices: Array
    faces: Indices
    normals: Array | None
    uvs: Array | None
    surface: Surface | None


def check_parts(parts: Sequence[MeshPart]) -> tuple[MeshPart, ...]:
    """Parts that can be drawn; normals, texture coordinates and colours that are no numbers are left out.

    Raises
    ------
    ValueError
        If there is no triangle, a corner is no point, or a triangle refers to a corner that is not there.
    """
    found = tuple(_check(part) for part in parts if len(part.faces) > 0)
    if not found:
        raise ValueError("no triangles in it")
    return found


def _check(part: MeshPart) -> MeshPart:
    if part.vertices.shape[1:] != (3,) or not 0 <= part.faces.min() <= part.faces.max() < len(part.vertices):
        raise ValueError("a triangle refers to a corner that is not there")
    if not np.all(np.abs(part.vertices) <= _MAX_COORDINATE):
        raise ValueError(f"a corner is not finite, or beyond {_MAX_COORDINATE:g}")
    shape = len(part.vertices)
    normals, uvs, surface = part.normals, part.uvs, part.surface
    if normals is not None and (normals.shape != (shape, 3) or not np.isfinite(normals).all()):
        normals = None
    if uvs is not None and (uvs.shape != (shape, 2) or not np.isfinite(uvs).all()):
        uvs = None
    if surface is not None and not np.isfinite(surface.colour).all():
        surface = replace(surface, colour=_GREY)
    return replace(part, normals=normals, uvs=uvs, surface=surface)


def distinct_rows(tuples: Indices) -> tuple[Indices, Indices]:
    """The different rows, and for each row its number among them."""
    if len(tuples) == 0:
        return tuples, np.zeros(0, dtype=np.int64)
    key = np.zeros(len(tuples), dtype=np.int64)
    for column in tuples.T:  # one number a row: sorting those is much faster than sorting rows
        _, rank = np.unique(column, return_inverse=True)
        key = key * (int(rank.max()) + 1) + rank
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    return tuples[first], inverse


def fans(counts: Indices, corners: int) -> Indices:
    """Corner numbers of the triangles of polygons with `counts` corners each, of `corners` that there are.

    Raises
    ------
    ValueError
        If a count is negative, or the polygons have more corners than there are.
    """
    if len(counts) == 0:
        return np.zeros(0, dtype=np.int64)
    if counts.min() < 0 or counts.max() > corners or counts.sum() > corners:
        raise ValueError(f"polygons with more corners than the {corners} that are given")
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    triangles = np.maximum(counts - 2, 0)
    start = np.repeat(starts, triangles)
    k = np.arange(len(start)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return np.stack([start, start + k + 1, start + k + 2], axis=1).ravel().astype(np.int64)


_SAME = 1e-7  # of the size: corners this near each other are one; STL has seven digits


def weld(vertices: Array, faces: Indices) -> tuple[Array, Indices]:
    """Make one corner of those at the same place, and leave out triangles without an area."""
    size = float(np.ptp(vertices, axis=0).max())
    rounded = np.round((vertices - vertices.min(axis=0)) / (size * _SAME)).astype(np.int64)
    _, first, same = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    faces = same.ravel()[faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    return vertices[first], faces


def count_open_edges(faces: Indices) -> int:
    """Count edges that have no second triangle the other way round; those of a closed surface are none."""
    edges = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    key = edges.min(axis=1) * (int(faces.max(initial=0)) + 1) + edges.max(axis=1)
    _, number = np.unique(key, return_inverse=True)
    turns = np.bincount(number.ravel(), weights=np.where(edges[:, 0] < edges[:, 1], 1.0, -1.0))
    return int(np.count_nonzero(turns))


def measure_enclosed_body(vertices: Array, faces: Indices, apex: Array | None = None) -> pin.Inertia:
    """Volume, its centre and its moments about it, of a closed surface.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        [m].
    faces : ndarray of int, shape (F, 3)
        All seen counterclockwise from outside, or all from inside.
    apex : ndarray, shape (3,), optional
        Of the tetrahedra; where it is given, these count without sign.

    Returns
    -------
    pin.Inertia
        That of a body of 1 kg/m^3.
    """
    origin = vertices.mean(axis=0) if apex is None else apex  # near the body, so that little cancels
    a, b, c = (vertices[faces[:, k]] - origin for k in range(3))
    dets = np.einsum("ij,ij->i", a, np.cross(b, c))
    dets = np.abs(dets) if apex is not None else dets if dets.sum() >= 0.0 else -dets
    sums = a + b + c
    volume = float(dets.sum()) / 6.0
    if volume == 0.0:
        return pin.Inertia.Zero()
    centre = dets @ sums / (24.0 * volume)
    second = sum(np.einsum("i,ij,ik->jk", dets, x, x) for x in (sums, a, b, c)) / 120.0
    second = second - volume * np.outer(centre, centre)
    return pin.Inertia(volume, origin + centre, np.trace(second) * np.eye(3) - second)


def fill(shape: coal.CollisionGeometry) -> pin.Inertia:
    """Body of 1 kg/m^3 in a primitive shape."""
    moments = np.asarray(shape.computeMomentofInertia())
    return pin.Inertia(float(shape.computeVolume()), np.zeros(3), moments)


def scale_mass(body: pin.Inertia, mass: float) -> pin.Inertia:
    """The same body of another mass; without a volume it is a point."""
    return pin.Inertia(mass, body.lever, np.asarray(body.inertia) * (mass / body.mass if body.mass else 0.0))
