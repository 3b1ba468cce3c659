r"""Signed distances of a point from shapes, smooth everywhere, for path constraints.

A shape is in a frame of its own. With :math:`s(w) = (w + \sqrt{w^2 + \varepsilon^2})/2`, a smooth
:math:`\max(w, 0)`, and :math:`|x|_\varepsilon = \sqrt{x^2 + \varepsilon^2}`:

- ``sphere``: :math:`|p|_\varepsilon - |r|_\varepsilon`;
- ``capsule`` along z: the same from the point of its axis that is next, whose offset along z is
  :math:`s(|z|_\varepsilon - |l|_\varepsilon)`;
- ``box`` with half sides b, and ``cylinder`` with radius and half length b: with the gaps
  :math:`g_i = |x_i|_\varepsilon - |b_i|_\varepsilon` to the sides,

  .. math:: d = \sqrt{\textstyle\sum_i s(g_i)^2} - s(-\max_\varepsilon g_i),

  outside the length of the way to the shape, inside less the way to the nearest side: its gradient is about
  one long on both sides and pushes out. Next to a side :math:`s(w) - s(-w) = w`, so that d is the distance;
- ``halfspace``: z.

Every d differs from the true distance by less than :math:`\varepsilon` within a few sizes of the shape,
and by much less away from edges and from the planes in the middle of a box.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import reduce

import casadi as ca

__all__ = ["distance_between_points", "signed_distance"]


def signed_distance(shape: str, p: ca.SX, sizes: ca.SX, smoothing: ca.SX) -> ca.SX:
    """Distance of a point from a shape's surface, negative inside [m].

    Parameters
    ----------
    shape : str
        A key of `mbocp.robot.collision.obstacle.SIZES`.
    p : casadi.SX, shape (3,)
        In the axes of the shape [m].
    sizes : casadi.SX
        Sides of a box; radius, and length of a capsule (of its axis) or a cylinder [m].
    smoothing : casadi.SX
        Epsilon [m].
    """
    return _DISTANCES[shape](p, sizes, smoothing)


def distance_between_points(a: ca.SX, b: ca.SX, smoothing: ca.SX) -> ca.SX:
    """Distance of two points, smooth where they meet [m]."""
    return ca.sqrt(ca.sumsqr(a - b) + smoothing**2)


def _sphere(p: ca.SX, sizes: ca.SX, e: ca.SX) -> ca.SX:
    return ca.sqrt(ca.sumsqr(p) + e**2) - _length(sizes[0], e)


def _capsule(p: ca.SX, sizes: ca.SX, e: ca.SX) -> ca.SX:
    beyond = _positive(_length(p[2], e) - _length(sizes[1] / 2, e), e)
    return ca.sqrt(p[0] ** 2 + p[1] ** 2 + beyond**2 + e**2) - _length(sizes[0], e)


def _box(p: ca.SX, sizes: ca.SX, e: ca.SX) -> ca.SX:
    return _convex([_length(p[i], e) - _length(sizes[i] / 2, e) for i in range(3)], e)


def _cylinder(p: ca.SX, sizes: ca.SX, e: ca.SX) -> ca.SX:
    across = ca.sqrt(p[0] ** 2 + p[1] ** 2 + e**2) - _length(sizes[0], e)
    return _convex([across, _length(p[2], e) - _length(sizes[1] / 2, e)], e)


def _halfspace(p: ca.SX, sizes: ca.SX, e: ca.SX) -> ca.SX:
    return p[2]


def _convex(gaps: list[ca.SX], e: ca.SX) -> ca.SX:
    outside = ca.sqrt(sum((_positive(gap, e) ** 2 for gap in gaps), ca.SX(0)))
    return outside - _positive(-reduce(lambda a, b: _largest(a, b, e), gaps), e)


def _length(x: ca.SX, e: ca.SX) -> ca.SX:
    return ca.sqrt(x**2 + e**2)


def _positive(w: ca.SX, e: ca.SX) -> ca.SX:
    return (w + _length(w, e)) / 2


def _largest(a: ca.SX, b: ca.SX, e: ca.SX) -> ca.SX:
    return (a + b + _length(a - b, e)) / 2


_DISTANCES: Mapping[str, Callable[[ca.SX, ca.SX, ca.SX], ca.SX]] = {
    "sphere": _sphere,
    "capsule": _capsule,
    "box": _box,
    "cylinder": _cylinder,
    "halfspace": _halfspace,
}
