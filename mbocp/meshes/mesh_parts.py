"""Parts of a mesh: triangles that share a surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
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
