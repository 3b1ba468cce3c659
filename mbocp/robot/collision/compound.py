"""Bodies that are not convex: their surface, and convex parts that stand for them where solvers see them."""

from __future__ import annotations

import io
import subprocess
from collections import Counter
from functools import cached_property
from importlib.util import find_spec
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass, freeze
from mbocp._processes import python_command
from mbocp._text import shorten
from mbocp.exceptions import InvalidValue
from mbocp.meshes.mesh_parts import Indices, weld
from mbocp.robot.collision.fit_cache import load_or_fit
from mbocp.robot.collision.geometry import mesh_of
from mbocp.robot.collision.hull import Hull, box_of, hull_of
from mbocp.robot.collision.solid import points_on

MAX_TRIANGLES = 20_000  # results keep them
CONCAVITY = 0.05  # of CoACD: of half the longest side, about; its own default
_CONCAVITIES = (0.01, 1.0)  # that it takes
_CONVEX = 0.01  # of a component's volume, by which its hull may be larger
_LOOKED_AT = 4000  # points on either surface
_POINT = 1e-6  # [m]: radius of a ball that stands for a point
_CHUNK = 2_000_000  # triangles seen from points at once
_COACD = """
import io
import coacd
import numpy as np
out = sys.stdout.buffer
with np.load(io.BytesIO(sys.stdin.buffer.read())) as given:
    mesh = coacd.Mesh(given["corners"], given["faces"].astype(np.int32))
coacd.set_log_level("off")
# A fourth of the time that it takes by default, and nearly as few parts.
parts = coacd.run_coacd(mesh, threshold=float(sys.argv[1]), mcts_nodes=10, mcts_iterations=60, seed=0)
body = io.BytesIO()
np.savez(body, *(corners for corners, _ in parts))
out.write(body.getvalue())
"""
_INSTALL = (
    "a convex one, or the package coacd, which cuts it into parts: pip install 'mbocp[scenes]'; hull = true "
    "takes its convex hull"
)


@dataclass(frozen=True, eq=False)
class Compound:
    """A closed surface, and the convex parts that stand for what it encloses.

    Attributes
    ----------
    vertices : ndarray, shape (V, 3)
        [m].
    faces : ndarray of int, shape (F, 3)
        Seen counterclockwise from outside.
    parts : tuple of Hull
    """

    vertices: Array
    faces: Indices
    parts: tuple[Hull, ...]

    def __post_init__(self) -> None:
        faces = np.asarray(self.faces)
        if faces.ndim != 2 or faces.shape[1] != 3 or not 0 < len(faces) <= MAX_TRIANGLES:
            expected = f"(n, 3), with n from 1 to {MAX_TRIANGLES}; give a mesh of fewer triangles"
            raise InvalidValue("faces", f"an array of shape {faces.shape}", expected)
        if not (faces.min() >= 0 and faces.max() < len(self.vertices)):
            raise InvalidValue("faces", "a corner that is not there", f"0 to {len(self.vertices) - 1}")
        freeze(self, "vertices", (None, 3), "vertices")

    @property
    def pieces(self) -> list[Hull | tuple[pin.SE3, Array]]:
        """Its parts; of those that are boxes the middles and axes, and the sides [m]."""
        return [box_of(part) or part for part in self.parts]

    @property
    def keys(self) -> dict[str, Any]:
        """What it is in a problem file."""
        parts = [np.asarray(part.vertices).tolist() for part in self.parts]
        return {"vertices": np.asarray(self.vertices), "faces": self.faces, "parts": parts}

    @property
    def words(self) -> str:
        """What the summary says of it."""
        out, left = (f"{1e3 * length:.2f} mm" for length in (self.sticks_out, self.uncovered))
        what = f"{len(self.parts)} convex parts stick out of its surface by {out}"
        return f"{what} and leave {left} of it uncovered at most"

    @cached_property
    def shape(self) -> coal.BVHModelOBBRSS:
        """The surface, as coal has it."""
        return mesh_of(self.vertices, self.faces)

    @cached_property
    def sticks_out(self) -> float:
        """How far parts reach beyond the surface at most, of points that were looked at [m]."""
        share = max(_LOOKED_AT // len(self.parts), 50)
        points = np.vstack([points_on(part.vertices, part.faces, share) for part in self.parts])
        away = _distances([self.shape], points)
        far = np.argsort(-away)
        for chunk in np.array_split(far, max(1, len(far) * len(self.faces) // _CHUNK)):
            outside = _turns(self.vertices[self.faces], points[chunk]) < 0.5
            if outside.any():
                return float(away[chunk][outside].max())
        return 0.0

    @cached_property
    def uncovered(self) -> float:
        """How far the surface is outside of all parts at most, of points that were looked at [m]."""
        points = points_on(self.vertices, self.faces, _LOOKED_AT)
        depths = np.full(len(points), np.inf)
        for part in self.parts:
            offsets = np.einsum("ij,ij->i", part.normals, part.vertices[part.faces[:, 0]])
            np.minimum(depths, (points @ part.normals.T - offsets).max(axis=1), out=depths)
        out = depths > _POINT
        return float(_distances([part.shape for part in self.parts], points[out]).max(initial=0.0))


def compound_of(vertices: Array, faces: Indices, concavity: float = CONCAVITY) -> Compound:
    """Cut what a closed surface encloses into convex parts.

    A component of the surface that is convex is a part. Others are cut by CoACD; parts are kept in the folder
    of compiled functions.

    Parameters
    ----------
    vertices, faces : ndarray, shapes (V, 3) and (F, 3)
        [m].
    concavity : float
        That CoACD leaves in a part; less gives more parts, which are closer to the surface.

    Raises
    ------
    InvalidValue
        If there are too many triangles, the concavity is none, or coacd is needed and not installed.

    References
    ----------
    Wei et al., "Approximate convex decomposition for 3D meshes with collision-aware concavity and tree
    search", 2022.
    """
    least, most = _CONCAVITIES
    if not least <= concavity <= most:
        raise InvalidValue("concavity", f"{concavity:g}", f"{least:g} to {most:g}")
    corners, faces = weld(vertices, faces)
    if _volumes(corners, faces).sum() < 0.0:
        faces = faces[:, ::-1]
    made = Compound(corners, faces, ())  # refuses what has too many triangles before that takes time
    numbers = [corners, faces.astype(np.float64), np.array(concavity)]
    found = load_or_fit([], numbers, lambda: _cut(corners, faces, concavity))
    ends = np.cumsum(found["counts"])[:-1]
    parts = tuple(hull_of(points) for points in np.split(found["corners"], ends))
    return Compound(made.vertices, made.faces, parts)


def _cut(corners: Array, faces: Indices, concavity: float) -> dict[str, Array]:
    """Corners of all parts, and how many each has."""
    parts: list[Array] = []
    for component in _components(corners, faces):
        points, volume = corners[np.unique(component)], float(_volumes(corners, component).sum())
        hull = hull_of(points)
        is_convex = hull.volume <= volume * (1.0 + _CONVEX)
        parts += [hull.vertices] if is_convex else _approximate(corners, component, concavity)
    return {"corners": np.vstack(parts), "counts": np.array([len(part) for part in parts])}


def _components(corners: Array, faces: Indices) -> list[Indices]:
    """Faces of each closed surface, as files have them one after the other.

    All together where one of these is the inside of another. Corners do not tell surfaces apart: those of
    boards side by side are the same.
    """
    found, first, open_edges = list[Indices](), 0, Counter[tuple[int, int]]()
    for last, (a, b, c) in enumerate(faces.tolist(), start=1):
        for one, other in ((a, b), (b, c), (c, a)):
            if open_edges[other, one] > 1:
                open_edges[other, one] -= 1
            elif open_edges[other, one]:
                del open_edges[other, one]
            else:
                open_edges[one, other] += 1
        if not open_edges:
            found.append(faces[first:last])
            first = last
    is_apart = first == len(faces) and all(_volumes(corners, one).sum() > 0.0 for one in found)
    return found if is_apart else [faces]


def _approximate(corners: Array, faces: Indices, concavity: float) -> list[Array]:
    """Corners of each part that CoACD finds, in a process of its own: broken meshes may end it."""
    if find_spec("coacd") is None:
        raise InvalidValue("file", "a mesh that is not convex", _INSTALL)
    used, numbers = np.unique(faces, return_inverse=True)
    body = io.BytesIO()
    np.savez(body, corners=corners[used], faces=numbers.reshape(-1, 3))
    command = python_command(_COACD, repr(concavity))
    done = subprocess.run(command, input=body.getvalue(), capture_output=True, check=False)
    if done.returncode:
        last = (done.stderr.decode(errors="replace").strip().splitlines() or [f"code {done.returncode}"])[-1]
        expected = "a mesh that CoACD can cut; repair it, or hull = true takes its convex hull"
        raise InvalidValue("file", f"a mesh at which CoACD failed: {shorten(last)}", expected)
    with np.load(io.BytesIO(done.stdout)) as parts:
        return [parts[name] for name in parts.files]


def _volumes(corners: Array, faces: Indices) -> Array:
    """Of the tetrahedra of each triangle and one point, with their signs [m^3]."""
    a, b, c = (corners[faces[:, k]] - corners[faces[0, 0]] for k in range(3))
    return np.asarray(np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0)


def _turns(triangles: Array, points: Array) -> Array:
    """How often a surface goes around each point: the solid angles of its triangles.

    References
    ----------
    Van Oosterom, Strackee, "The solid angle of a plane triangle", 1983.
    """
    a, b, c = (triangles[None, :, k] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=2) for side in (a, b, c))
    above = np.einsum("ijk,ijk->ij", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("ijk,ijk->ij", x, y) for x, y in ((a, b), (b, c), (c, a)))
    below = la * lb * lc + ab * lc + bc * la + ca * lb
    return np.asarray(np.arctan2(above, below).sum(axis=1) / (2.0 * np.pi))


def _distances(shapes: list[coal.CollisionGeometry], points: Array) -> Array:
    """Of points from the nearest of shapes [m]; 0 within convex ones."""
    here, ball, request = coal.Transform3s(), coal.Sphere(_POINT), coal.DistanceRequest()
    found = np.full(len(points), np.inf)
    for n, point in enumerate(points):
        there = coal.Transform3s(np.eye(3), point)
        for shape in shapes:
            distance = coal.distance(shape, here, ball, there, request, coal.DistanceResult())
            found[n] = min(found[n], max(float(distance) + _POINT, 0.0))
    return found
