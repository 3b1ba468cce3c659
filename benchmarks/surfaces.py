"""Obstacles of files for `benchmarks.scenes`: meshes and clouds, and what an independent check looks at.

Within each sphere stands a convex polyhedron, within each box one to three boards of one mesh. A cloud has
points on the sides of all spheres and boxes. They are written and read back by programs that share nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from mbocp._arrays import Array

__all__ = ["SURFACES", "surfaces_of"]

Words = dict[str, Any]

_CORNERS = 24  # of a polyhedron
_BOARD = 0.25  # of a side of a box: thickness
_DENSE = 2.5e4  # points of a cloud on 1 m^2
_RESOLUTION = 0.02  # [m]
_POINT = 2e-4  # [m]: of the triangle that stands for a point


def _meshes(obstacles: Sequence[Words], rng: np.random.Generator, folder: Path) -> list[Words]:
    """Each obstacle as a mesh in its place."""
    found = []
    for number, words in enumerate(obstacles):
        solids = _polyhedron(words, rng) if words["shape"] == "sphere" else _boards(words, rng)
        file = folder / f"mesh_{number}.obj"
        _write(file, solids)
        place = {key: words[key] for key in ("position", "orientation") if key in words}
        found.append({"name": f"mesh {number}", "shape": "mesh", "file": str(file), **place})
    return found


def _polyhedron(words: Words, rng: np.random.Generator) -> list[Array]:
    directions = rng.normal(size=(_CORNERS, 3))
    return [words["radius"] * directions / np.linalg.norm(directions, axis=1, keepdims=True)]


def _boards(words: Words, rng: np.random.Generator) -> list[Array]:
    """Corners of boards at one to three sides of a box."""
    half, found = np.array(words["size"]) / 2.0, []
    for axis in rng.permutation(3)[: rng.integers(1, 4)]:
        low, high = -half, half.copy()
        high[axis] = low[axis] * (1.0 - 2.0 * _BOARD)
        found.append(np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1])
                               for z in (low[2], high[2])]))  # fmt: skip
    return found


def _write(file: Path, solids: Sequence[Array]) -> None:
    """Hulls of corners one after the other, faces counterclockwise from outside."""
    lines, first = list[str](), 1
    for corners in solids:
        hull = ConvexHull(corners)
        lines += [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in corners]
        for triangle, normal in zip(hull.simplices, hull.equations[:, :3], strict=True):
            a, b, c = corners[triangle]
            is_outwards = np.cross(b - a, c - a) @ normal > 0.0
            lines.append("f " + " ".join(str(first + k) for k in triangle[:: 1 if is_outwards else -1]))
        first += len(corners)
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _cloud(obstacles: Sequence[Words], rng: np.random.Generator, folder: Path) -> list[Words]:
    """All obstacles as one cloud."""
    points = np.vstack([_scan(words, rng) for words in obstacles])
    np.save(folder / "cloud.npy", points)
    file = str(folder / "cloud.npy")
    return [{"name": "cloud", "shape": "cloud", "file": file, "resolution": _RESOLUTION}]


def _scan(words: Words, rng: np.random.Generator) -> Array:
    """Points on the surface of a sphere or a box, in the world."""
    at = np.array(words["position"])
    if words["shape"] == "sphere":
        directions = rng.normal(size=(int(_DENSE * 4.0 * np.pi * words["radius"] ** 2), 3))
        return at + words["radius"] * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    size, turn = np.array(words["size"]), pin.Quaternion(np.array(words["orientation"])).matrix()
    points = []
    for axis in range(3):
        for side in (-0.5, 0.5):
            count = int(_DENSE * np.delete(size, axis).prod())
            own = rng.uniform(-0.5, 0.5, (count, 3))
            own[:, axis] = side
            points.append(own * size)
    return at + np.vstack(points) @ turn.T


SURFACES: Mapping[str, Callable[[Sequence[Words], np.random.Generator, Path], list[Words]]] = {
    "meshes": _meshes,
    "cloud": _cloud,
}


def surfaces_of(tables: Sequence[Mapping[str, Any]]) -> list[pin.GeometryObject]:
    """Surfaces of files on joint 0, from what tables of obstacles say."""
    found = []
    for words in tables:
        corners, faces = _read_points(words) if words["shape"] == "cloud" else _read_mesh(words)
        shape = coal.BVHModelOBBRSS()
        shape.beginModel(len(faces), len(corners))
        shape.addVertices(corners)
        shape.addTriangles(faces)
        shape.endModel()
        turn = pin.Quaternion(np.array(words.get("orientation", [0.0, 0.0, 0.0, 1.0])))
        place = pin.SE3(turn.matrix(), np.array(words.get("position", [0.0, 0.0, 0.0])))
        found.append(pin.GeometryObject(words["name"], 0, place, shape))
    return found


def _read_mesh(words: Mapping[str, Any]) -> tuple[Array, Array]:
    lines = [line.split() for line in Path(words["file"]).read_text(encoding="utf-8").splitlines()]
    corners = np.array([line[1:] for line in lines if line[0] == "v"], dtype=float)
    return corners, np.array([line[1:] for line in lines if line[0] == "f"], dtype=int) - 1


def _read_points(words: Mapping[str, Any]) -> tuple[Array, Array]:
    """A small triangle at each point."""
    points = np.load(words["file"])
    triangle = _POINT * np.array([[1.0, 0.0, -0.5], [-0.5, 1.0, 0.0], [0.0, -0.5, 1.0]])
    return (points[:, None] + triangle).reshape(-1, 3), np.arange(3 * len(points)).reshape(-1, 3)
