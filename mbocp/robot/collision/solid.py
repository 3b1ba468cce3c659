"""Solids, and points on their surfaces: the same for the same shape, as evenly spread as is easy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.meshes.mesh_parts import Indices
from mbocp.meshes.triangles import triangles_of

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_PLASTIC = 1.22074408460575947536  # real root of x^4 = x + 1: the most even sequence in three dimensions
_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))  # [rad]
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)


def sequence(count: int, start: int = 0) -> Array:
    """Rows `start` to `start + count` of an additive sequence, evenly spread in the unit cube, (count, 3).

    References
    ----------
    Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018.
    """
    steps = _PLASTIC ** -np.arange(1.0, 4.0)
    index = np.arange(start + 1, start + count + 1)[:, None]
    return np.mod(0.5 + index * steps, 1.0)


def directions(count: int) -> Array:
    """Unit vectors along a spiral, evenly spread, shape (count, 3)."""
    z = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    angle = _GOLDEN * np.arange(count)
    across = np.sqrt(1.0 - z**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)


def box_around(shape: coal.CollisionGeometry) -> Array:
    """Corners of the box around a shape along its own axes, shape (8, 3) [m]."""
    shape.computeLocalAABB()
    return np.asarray(np.where(CORNERS > 0.0, shape.aabb_local.max_, shape.aabb_local.min_))


def surface_points(shape: pin.GeometryObject, count: int, start: int = 0) -> Array:
    """Points on a shape's surface, corners and rims among them, in its joint's frame, shape (M, 3) [m].

    Parameters
    ----------
    shape : pin.GeometryObject
    count : int
        About as many.
    start : int
        Another start gives other points.
    """
    geometry = shape.geometry
    if isinstance(geometry, coal.Box):
        points = _box(np.asarray(geometry.halfSide), count, start)
    elif isinstance(geometry, coal.Sphere):
        points = geometry.radius * directions(count + start % 7)
    elif isinstance(geometry, coal.Cylinder):
        points = _cylinder(geometry.radius, geometry.halfLength, count, start)
    elif isinstance(geometry, coal.Capsule):
        points = _capsule(geometry.radius, geometry.halfLength, count, start)
    else:
        points = points_on(*triangles_of(geometry), count, start)
    return points @ shape.placement.rotation.T + shape.placement.translation


def _box(half: Array, count: int, start: int) -> Array:
    areas = np.array([half[1] * half[2], half[0] * half[2], half[0] * half[1]])
    shares = np.repeat(areas / areas.sum(), 2) / 2.0  # of the faces at -x, +x, -y, ...
    points = [CORNERS]
    for face, share in enumerate(shares):
        on_face = 2.0 * sequence(max(int(share * count), 16), start) - 1.0
        on_face[:, face // 2] = 1.0 if face % 2 else -1.0
        points.append(on_face)
    return np.vstack(points) * half


def _cylinder(radius: float, half: float, count: int, start: int) -> Array:
    rim = _circle(radius, 48)
    side_area, cap_area = 4.0 * np.pi * radius * half, 2.0 * np.pi * radius**2
    u = sequence(count, start)
    is_side = u[:, 0] < side_area / (side_area + cap_area)
    angle = 2.0 * np.pi * u[:, 1]
    distance = np.where(is_side, radius, radius * np.sqrt(u[:, 2]))
    cap = np.where(np.arange(count) % 2 == 0, half, -half)
    height = np.where(is_side, half * (2.0 * u[:, 2] - 1.0), cap)
    points = np.stack([distance * np.cos(angle), distance * np.sin(angle), height], axis=1)
    up = np.array([0.0, 0.0, half])
    return np.vstack([rim + up, rim - up, points])


def _capsule(radius: float, half: float, count: int, start: int) -> Array:
    round_part = 2.0 * half / (2.0 * half + 2.0 * radius)
    balls = max(int(count * (1.0 - round_part)), 32)
    ends = radius * directions(balls + start % 7)
    ends[:, 2] += np.where(ends[:, 2] >= 0.0, half, -half)
    u = sequence(count, start)
    angle = 2.0 * np.pi * u[:, 1]
    height = half * (2.0 * u[:, 2] - 1.0)
    side = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
    return np.vstack([ends, side])


def _circle(radius: float, count: int) -> Array:
    angle = 2.0 * np.pi * np.arange(count) / count
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(count)], axis=1)


def points_on(vertices: Array, faces: Indices, count: int, start: int = 0) -> Array:
    """Corners of triangles and points on them, about as many of either as are asked for, shape (M, 3) [m]."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    u = sequence(count, start)
    share = np.cumsum(areas) / max(float(areas.sum()), 1e-300)
    face = np.minimum(np.searchsorted(share, u[:, 0], side="right"), len(faces) - 1)
    root = np.sqrt(u[:, 1:2])
    inner = (1 - root) * a[face] + root * (1 - u[:, 2:]) * b[face] + root * u[:, 2:] * c[face]
    used = np.unique(faces)
    corners = vertices[used[:: max(1, len(used) // count)]]
    return np.vstack([corners, inner])


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
