"""Convex hulls of points, as obstacles have them."""

from __future__ import annotations

from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp.exceptions import InvalidValue
from mbocp.meshes.mesh_parts import Indices

MAX_CORNERS = 5000
_LEAST_VOLUME = 1e-9  # of the cube over the diagonal
_LARGEST = 1e6  # [m]
_FLAT = 1e-5  # of a box's longest side, by which its corners may be elsewhere


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


def box_of(hull: Hull) -> tuple[pin.SE3, Array] | None:
    """Where a hull is a box, that box: its middle and axes, and its sides [m]."""
    if len(hull.vertices) != 8:
        return None
    across = np.abs(hull.normals @ hull.normals.T)
    first = hull.normals[0]
    second = hull.normals[int(across[0].argmin())]
    axes = np.column_stack([first, second, np.cross(first, second)])
    along = hull.vertices @ axes
    low, high = along.min(axis=0), along.max(axis=0)
    corners = np.minimum(along - low, high - along)
    if corners.max() > _FLAT * float((high - low).max()) or across[0].min() > _FLAT:
        return None
    return pin.SE3(axes, axes @ (0.5 * (low + high))), high - low


@lru_cache(maxsize=64)
def _convex(hull: Hull) -> coal.Convex:
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(np.array(hull.vertices)))
    triangles.extend([coal.Triangle(*face) for face in hull.faces.tolist()])
    return coal.Convex(points, triangles)
