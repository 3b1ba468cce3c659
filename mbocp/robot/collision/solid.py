"""The space that a link's collision shapes fill, on a grid: what is inside, how far outside a point is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.meshes.mesh_parts import Indices
from mbocp.meshes.triangles import triangles_of
from mbocp.robot.collision.samples import surface_points

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_CELLS = 40  # along the longest side
_SURFACE = 6000  # points that distances are measured to
_SHIFT = 1e-4  # of a cell: rays do not hit the edges of meshes that lie on a grid
_MAX_PAIRS = 20_000_000  # of a triangle and a ray


@dataclass(frozen=True, eq=False)
class Solid:
    """What shapes fill, all in the frame of one joint.

    Attributes
    ----------
    low : ndarray, shape (3,)
        Corner of the grid [m].
    cell : float
        Side of a cell [m].
    filled : ndarray of bool, shape (nx, ny, nz)
        Whether the centre of a cell is inside.
    surface : ndarray, shape (M, 3)
        Points on the surface [m].
    """

    low: Array
    cell: float
    filled: BoolArray
    surface: Array
    _tree: cKDTree

    @classmethod
    def of(cls, shapes: Sequence[pin.GeometryObject]) -> Solid:
        """Fill the grid."""
        from scipy.spatial import cKDTree  # slow to import, and wanted only where spheres are fitted

        share = max(_SURFACE // len(shapes), 500)
        surface = np.vstack([surface_points(shape, share) for shape in shapes])
        low, high = surface.min(axis=0), surface.max(axis=0)
        cell = float((high - low).max()) / _CELLS
        counts = np.maximum(np.ceil((high - low) / cell).astype(int), 1)
        axes = [low[k] + cell * (np.arange(counts[k]) + 0.5 + _SHIFT) for k in range(3)]
        filled = np.zeros(tuple(counts), dtype=np.bool_)
        for shape in shapes:
            filled |= _inside(shape, axes)
        return cls(low, cell, filled, surface, cKDTree(surface))

    @property
    def inner(self) -> Array:
        """Centres of the cells that are filled, shape (M, 3) [m]."""
        return self.low + self.cell * (np.argwhere(self.filled) + 0.5)

    def outside(self, points: Array) -> Array:
        """How far points are outside, shape (M,) [m]; 0 within.

        Too large by no more than the distance between points of the surface.
        """
        index = np.floor((points - self.low) / self.cell).astype(int)
        within = np.all((index >= 0) & (index < self.filled.shape), axis=1)
        inside = np.zeros(len(points), dtype=np.bool_)
        inside[within] = self.filled[tuple(index[within].T)]
        distances = np.zeros(len(points))
        distances[~inside] = self._tree.query(points[~inside])[0]
        return distances


def _inside(shape: pin.GeometryObject, axes: Sequence[Array]) -> BoolArray:
    """Which points of a grid are within a shape."""
    geometry, placement = shape.geometry, shape.placement
    if isinstance(geometry, coal.BVHModelBase):
        vertices, faces = triangles_of(geometry)
        return _within_mesh(vertices @ placement.rotation.T + placement.translation, faces, axes)
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    p = (grid - placement.translation) @ placement.rotation
    if isinstance(geometry, coal.Box):
        return np.all(np.abs(p) <= np.asarray(geometry.halfSide), axis=-1)
    if isinstance(geometry, coal.Sphere):
        return np.asarray(np.linalg.norm(p, axis=-1) <= geometry.radius)
    across, half = np.linalg.norm(p[..., :2], axis=-1), geometry.halfLength
    if isinstance(geometry, coal.Cylinder):
        return np.asarray((across <= geometry.radius) & (np.abs(p[..., 2]) <= half))
    along = np.maximum(np.abs(p[..., 2]) - half, 0.0)
    return np.asarray(np.hypot(across, along) <= geometry.radius)


def _within_mesh(vertices: Array, faces: Indices, axes: Sequence[Array]) -> BoolArray:
    """Points from which rays along most axes cross the surface an odd number of times.

    A mesh with a hole is closed for the rays that do not go through the hole.
    """
    votes = np.zeros(tuple(len(axis) for axis in axes), dtype=np.int8)
    for along in range(3):
        order = [(along + 1) % 3, (along + 2) % 3, along]
        odd = _crossings(vertices[:, order], faces, [axes[k] for k in order])
        votes += np.transpose(odd, np.argsort(order))
    return np.asarray(votes >= 2)


def _crossings(vertices: Array, faces: Indices, axes: Sequence[Array]) -> BoolArray:
    """Whether the number of crossings below each point is odd, along the third axis."""
    corners = vertices[faces]  # (F, 3, 3)
    first = [np.searchsorted(axes[k], corners[:, :, k].min(axis=1)) for k in (0, 1)]
    last = [np.searchsorted(axes[k], corners[:, :, k].max(axis=1)) for k in (0, 1)]
    wide, high = (np.maximum(last[k] - first[k], 0) for k in (0, 1))
    pairs = wide * high
    count = np.zeros((len(axes[0]), len(axes[1]), len(axes[2]) + 1), dtype=np.int64)
    if pairs.sum() > _MAX_PAIRS:
        raise ValueError("too many triangles of its size")
    face = np.repeat(np.arange(len(faces)), pairs)
    within = np.arange(len(face)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
    i = first[0][face] + within // np.maximum(high[face], 1)
    j = first[1][face] + within % np.maximum(high[face], 1)
    a, b, c = (corners[face, k] for k in range(3))
    x, y = axes[0][i], axes[1][j]
    area = _turn(a, b, c[:, 0], c[:, 1])
    area = np.where(area == 0.0, np.inf, area)
    wa, wb = _turn(b, c, x, y) / area, _turn(c, a, x, y) / area
    hit = (wa >= 0.0) & (wb >= 0.0) & (wa + wb <= 1.0) & np.isfinite(area)
    height = wa * a[:, 2] + wb * b[:, 2] + (1.0 - wa - wb) * c[:, 2]
    np.add.at(count, (i[hit], j[hit], np.searchsorted(axes[2], height[hit])), 1)
    return np.cumsum(count, axis=2)[:, :, :-1] % 2 == 1


def _turn(a: Array, b: Array, x: Array, y: Array) -> Array:
    """Twice the signed area of triangles (a, b, (x, y)), seen along the third axis."""
    return (b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])
