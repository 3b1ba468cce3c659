r"""What triangles enclose: volume, centre and moments, by the divergence theorem.

Each triangle (a, b, c) is the base of a tetrahedron whose apex is the origin. With
:math:`d = a \cdot (b \times c)` and :math:`s = a + b + c`, the integrals of 1, x and :math:`x x^T` over it
are :math:`d/6`, :math:`d s/24` and :math:`d (s s^T + a a^T + b b^T + c c^T)/120`. What lies outside of the
body counts as often with either sign of d.
"""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.meshes.mesh_parts import Indices

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


def enclosed_body(vertices: Array, faces: Indices, apex: Array | None = None) -> pin.Inertia:
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
