r"""Planes around a convex body whose largest distance is nearly the distance from the body.

From a point p a plane with unit normal n that touches a body K is at
:math:`n \cdot p - \max_{x \in K} n \cdot x`, which is never more than the distance of p from K; the
distance is the largest of these over all n, outside and, as the depth, inside. Of finitely many planes the
largest is exact next to the faces that are among them, and too small beyond edges and corners. How much too
small, for points up to a distance d, is known
exactly: what is nearer than d by the planes is a polytope, the distance from K is a convex function, and its
largest value is at a corner of the polytope. Planes that touch K towards the worst corner are added until
that is small enough: so the planes round edges and corners off, and of a body of very many faces they are a
simpler one around it.

References
----------
Boyd, Vandenberghe, "Convex Optimization", 2004, sections 2.5 and 8.1: supporting planes and distances.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import coal
import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.robot.collision.hull import Hull

_LEAST_REACH = 1e-3  # [m]
_SAME = 1.0 - 1e-12  # cosine of normals that are one: depths are wrong by a millionth of the size at most
_APART = 0.97  # cosine of normals that are added at once
_POINT = 1e-9  # [m] radius of a point
_SHARE = 0.5  # of the worst error: corners below are left to the next turn


class Planes(NamedTuple):
    """Planes that touch a body.

    Attributes
    ----------
    normals : ndarray, shape (M, 3)
        Outwards, of unit length.
    offsets : ndarray, shape (M,)
        n . x on the planes, x from the hull's middle [m].
    error : float
        How much the largest distance from the planes is too small at most, up to the distance that was
        asked for [m]; it is never too large.
    slope : float
        The largest distance from the planes is at least this times the way to the middle, less the largest
        offset.
    """

    normals: Array
    offsets: Array
    error: float
    slope: float


@lru_cache(maxsize=64)
def planes_around(hull: Hull, reach: float, tolerance: float, most: int) -> Planes:
    """Planes that tell the distance from a hull.

    Parameters
    ----------
    hull : Hull
    reach : float
        Up to which the error counts [m].
    tolerance : float
        Error that is small enough [m].
    most : int
        Number of planes; where they do not suffice, the error is larger.
    """
    corners, reach = hull.vertices - hull.middle, max(reach, _LEAST_REACH)
    normals = _distinct(hull.normals)
    if len(normals) > most // 2:
        normals = np.vstack([np.eye(3), -np.eye(3)])
    while True:
        offsets = (normals @ corners.T).max(axis=1)
        errors, away = _at_corners(hull, normals, offsets, reach)
        error = float(errors.max())
        if error <= tolerance or len(normals) >= most:
            slope = 1.0 / float(np.linalg.norm(_corners(normals, np.ones(len(normals))), axis=1).max())
            return Planes(frozen_array(normals), frozen_array(offsets), max(error, 0.0), slope)
        added: list[Array] = []
        for k in np.argsort(-errors, kind="stable"):
            if errors[k] < max(tolerance, _SHARE * error) or len(normals) + len(added) >= most:
                break
            if all(float(away[k] @ other) < _APART for other in added):
                added.append(away[k])
        normals = np.vstack([normals, *added])


def _distinct(normals: Array) -> Array:
    """Normals of different directions, in their order."""
    kept: list[int] = []
    for k, normal in enumerate(normals):
        if not kept or (normals[kept] @ normal).max() < _SAME:
            kept.append(k)
    return np.array(normals[kept])


def _at_corners(hull: Hull, normals: Array, offsets: Array, reach: float) -> tuple[Array, Array]:
    """Errors at the corners of what is nearer than `reach` by the planes, and directions from the hull."""
    points = _corners(normals, offsets + reach)
    errors, away = np.zeros(len(points)), np.zeros((len(points), 3))
    here, ball = coal.Transform3s(), coal.Sphere(_POINT)
    for k, point in enumerate(points):
        request, result = coal.DistanceRequest(True), coal.DistanceResult()
        there = coal.Transform3s(np.eye(3), point + hull.middle)
        errors[k] = float(coal.distance(hull.shape, here, ball, there, request, result)) + _POINT - reach
        way = point + hull.middle - np.asarray(result.getNearestPoint1())
        away[k] = way / np.linalg.norm(way)
    return errors, away


def _corners(normals: Array, offsets: Array) -> Array:
    """Corners of the polytope n . x <= offset, which has 0 inside."""
    from scipy.spatial import HalfspaceIntersection  # slow to import, and few problems have hulls

    sides = np.column_stack([normals, -offsets])
    return np.asarray(HalfspaceIntersection(sides, np.zeros(3)).intersections)
