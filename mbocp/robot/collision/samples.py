"""Points on the surface of collision shapes: the same for the same shape, as evenly spread as is easy."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.meshes.mesh_parts import Indices
from mbocp.meshes.triangles import triangles_of

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
