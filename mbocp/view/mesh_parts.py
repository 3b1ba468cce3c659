"""What a mesh file holds: triangles that share a surface."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbocp._arrays import Array

__all__ = ["Indices", "MeshPart", "Surface", "distinct_rows", "fans"]

Indices = NDArray[np.int64]


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


def distinct_rows(tuples: Indices) -> tuple[Indices, Indices]:
    """The different rows, and for each row its number among them."""
    key = np.zeros(len(tuples), dtype=np.int64)
    for column in tuples.T:  # one number a row: sorting those is much faster than sorting rows
        _, rank = np.unique(column, return_inverse=True)
        key = key * (int(rank.max()) + 1) + rank
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    return tuples[first], inverse


def fans(counts: Indices) -> Indices:
    """Corner numbers of the triangles of polygons with `counts` corners each."""
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    triangles = np.maximum(counts - 2, 0)
    start = np.repeat(starts, triangles)
    k = np.arange(len(start)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return np.stack([start, start + k + 1, start + k + 2], axis=1).ravel().astype(np.int64)
