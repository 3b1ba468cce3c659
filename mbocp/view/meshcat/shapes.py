"""Triangle meshes that meshcat has no primitive for: tubes, coils, cones; and the floor's lines."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array
from mbocp.meshes.mesh_parts import Indices
from mbocp.view.meshcat.commands import mg

Colour = tuple[float, float, float]


def nice_length(length: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above `length`."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(k * power for k in (1.0, 2.0, 5.0) if k * power <= length * (1.0 + 1e-12)))


def path_tube(points: Array, radius: float, colours: Array) -> mg.Geometry:
    """A tube along a polyline (K, 3) with one colour (K, 3) a point; repeated points are dropped."""
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    keep = np.concatenate([[True], step > 1e-9 * max(1.0, float(step.sum()))])
    return tube(points[keep], radius, colours[keep])


def tube(points: Array, radius: float, colours: Array | None = None, sides: int = 8) -> mg.Geometry:
    """A closed tube around the polyline `points`, shape (K, 3), K >= 2 [m]."""
    count = len(points)
    tangents = np.gradient(points, axis=0)
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-300)
    angles = 2.0 * np.pi * np.arange(sides) / sides
    normal = _any_normal(tangents[0])
    rings = np.empty((count, sides, 3))
    for i, tangent in enumerate(tangents):
        normal = normal - tangent * (
            normal @ tangent
        )  # transported along the path, so the tube does not twist
        size = float(np.linalg.norm(normal))
        normal = normal / size if size > 1e-6 else _any_normal(tangent)
        binormal = np.cross(tangent, normal)
        rings[i] = points[i] + radius * (
            np.outer(np.cos(angles), normal) + np.outer(np.sin(angles), binormal)
        )
    vertices = np.vstack([rings.reshape(-1, 3), points[:1], points[-1:]])
    tint = None
    if colours is not None:
        tint = np.vstack([np.repeat(colours, sides, axis=0), colours[:1], colours[-1:]])
    a, b, end = *_neighbours(sides), (count - 1) * sides
    first, last = np.full(sides, count * sides), np.full(sides, count * sides + 1)
    caps = [np.stack([first, b, a], axis=1), np.stack([last, end + a, end + b], axis=1)]
    return mg.TriangularMeshGeometry(vertices, np.vstack([_strips(count, sides), *caps]), tint)


def cone(radius: float, length: float, sides: int = 16) -> mg.Geometry:
    """A closed cone along z, its base at z = 0 [m]."""
    angles, (k, after) = 2.0 * np.pi * np.arange(sides) / sides, _neighbours(sides)
    ring = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.zeros(sides)])
    vertices = np.vstack([ring, [[0.0, 0.0, length], [0.0, 0.0, 0.0]]])
    tip, base = np.full(sides, sides), np.full(sides, sides + 1)
    faces = np.vstack([np.column_stack([k, after, tip]), np.column_stack([after, k, base])])
    return mg.TriangularMeshGeometry(vertices, faces)


def _neighbours(sides: int) -> tuple[Indices, Indices]:
    """Numbers of a ring's points, and of the points after them."""
    numbers = np.arange(sides, dtype=np.int64)
    return numbers, np.roll(numbers, -1)


def _strips(count: int, sides: int) -> Indices:
    """Triangles between rings of points, each ring with the next."""
    ring = sides * np.arange(count - 1)[:, None]
    a, b = (ring + k for k in _neighbours(sides))
    return np.stack([a, b, b + sides, a, b + sides, a + sides], axis=-1).reshape(-1, 3)


def _any_normal(tangent: Array) -> Array:
    other = np.eye(3)[int(np.argmin(np.abs(tangent)))]
    normal = np.cross(tangent, other)
    return np.asarray(normal / max(float(np.linalg.norm(normal)), 1e-300))


def coil(length: float, radius: float, turns: int = 9) -> mg.Geometry:
    """A helical spring from the origin to (0, 0, length), with straight ends [m]."""
    s = np.linspace(0.0, 1.0, 24 * turns + 1)
    swell = np.clip(np.minimum(s, 1.0 - s) / 0.04, 0.0, 1.0)  # the wire leaves the axis and returns to it
    angle = 2.0 * np.pi * turns * s
    helix = np.stack(
        [radius * swell * np.cos(angle), radius * swell * np.sin(angle), length * (0.12 + 0.76 * s)], axis=1
    )
    points = np.vstack([[[0.0, 0.0, 0.0]], helix, [[0.0, 0.0, length]]])
    return tube(points, 0.16 * radius, sides=6)


def floor_lines(centre: Array, reach: float, cell: float, inner: Colour, outer: Colour) -> mg.Geometry:
    """Line segments of a round grid about `centre`, (3,), on multiples of `cell` [m], fading outwards."""
    middle = np.round(centre[:2] / cell) * cell
    count = int(reach / cell)
    segments = []
    for k in range(-count, count + 1):
        half = np.sqrt(reach**2 - (k * cell) ** 2)
        stops = np.linspace(-half, half, 2 * int(np.ceil(half / cell)) + 1)  # pieces, for the colours
        along = np.column_stack([stops[:-1], stops[1:]]).ravel()
        across = np.full(len(along), k * cell)
        segments += [np.column_stack([along, across]), np.column_stack([across, along])]
    flat = np.vstack(segments)
    colours = _fade(np.linalg.norm(flat, axis=1) / reach, inner, outer)
    points = np.column_stack([flat + middle, np.full(len(flat), centre[2])])
    return mg.PointsGeometry(points.astype(np.float32).T, colours.astype(np.float32).T)


def floor_disc(centre: Array, reach: float, inner: Colour, outer: Colour) -> mg.Geometry:
    """A horizontal disc about `centre`, (3,), seen from above, whose colour fades outwards [m]."""
    rings, sectors = 24, 72
    angles = 2.0 * np.pi * np.arange(sectors) / sectors
    radii = np.linspace(0.0, 1.0, rings + 1)
    circle = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(sectors)])
    vertices = np.asarray(centre) + reach * np.einsum("r,sk->rsk", radii, circle).reshape(-1, 3)
    upwards = _strips(rings + 1, sectors)[:, ::-1]
    return mg.TriangularMeshGeometry(vertices, upwards, _fade(np.repeat(radii, sectors), inner, outer))


def _fade(distance: Array, inner: Colour, outer: Colour) -> Array:
    """Colours from `inner` at distance 0 to `outer` at 1, level at both ends."""
    share = (distance * distance * (3.0 - 2.0 * np.clip(distance, 0.0, 1.0)))[:, None]
    return np.asarray(np.array(inner) + np.clip(share, 0.0, 1.0) * (np.array(outer) - np.array(inner)))
