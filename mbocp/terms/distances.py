r"""Signed distance of a point from a shape, smooth everywhere, for path constraints: one function for all.

A shape is a core, in a frame of its own, that is rounded by a radius r. With
:math:`s(w) = (w + \sqrt{w^2 + \varepsilon^2})/2`, a smooth :math:`\max(w, 0)`,
:math:`|x|_\varepsilon = \sqrt{x^2 + \varepsilon^2}` and the gaps to the core's sides
:math:`g_1 = \sqrt{x^2 + \lambda y^2 + \varepsilon^2} - \beta_1`, :math:`g_2 = |y|_\varepsilon - \beta_2` and
:math:`g_3 = |z|_\varepsilon - \beta_3`,

.. math:: d = \sqrt{\textstyle\sum_i s(g_i)^2} - s(-\max_\varepsilon g_i) - r,

outside the length of the way to the shape, inside less the way to the nearest side: its gradient is about one
long on both sides and pushes out. Next to a side :math:`s(w) - s(-w) = w`, so that d is the distance.

- ``box`` with half sides b: :math:`\beta_i = |b_i|_\varepsilon`;
- ``cylinder`` along z: :math:`\lambda = 1`, :math:`\beta_1` of the radius, :math:`\beta_3` of half the
  length, and nothing across y: :math:`\beta_2` is large;
- ``capsule`` along z: the core is its axis, :math:`\beta = (0, 0, |l/2|_\varepsilon)`;
- ``sphere``: the core is a point, :math:`\beta = 0`; a sphere of another link is one, too;
- ``halfspace``: a large box below z = 0.

Every d differs from the true distance by less than :math:`\varepsilon` within a few sizes of the shape, and
by much less away from edges, from the planes in the middle of a box, and from points and axes that are nearer
than a few :math:`\varepsilon`.

A hull is planes that touch it, :math:`n_i \cdot p \le b_i`, see `mbocp.robot.collision.planes`: the largest
:math:`g_i = n_i \cdot p - b_i` is the distance outside and less the depth inside, too small by a stated error
beyond edges and corners. Its smooth form

.. math:: d = \tfrac1k \log \textstyle\sum_i e^{k g_i}, \qquad k = \log(M) / \varepsilon

of M planes is larger than it by :math:`\varepsilon` at most, where all planes are equally far, and by nothing
next to a side. With :math:`w_i = e^{k g_i} / \sum_j e^{k g_j}` its gradient is :math:`\sum_i w_i n_i` and its
curvature :math:`k (\sum_i w_i n_i n_i^T - \nabla d \nabla d^T)`, so that d is convex. Planes are numbers;
functions depend on how many there is room for.

What is far does not matter to a motion, but with its curvature Newton's method takes more iterations:
where d is well beyond what a row keeps, it levels off, see `level_off`.

A sum over planes was chosen over the projection onto the hull, whose second derivatives jump wherever the
nearest face, edge or corner changes, and over the largest distance from the faces alone, which beyond a
corner of a cube is 0.58 of the true one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from operator import add
from typing import ClassVar, NamedTuple

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass

CORE = 5  # numbers of a core
# [m] beyond what a row keeps, see `level_off`. The kernel starts slacks 0.1 m above their bounds, or 10 % of
# these: rows that level off below that begin violated, with no slope to mend it, and some solves fail.
_AS_GIVEN, _LEVEL = 0.1, 0.18
_BROAD = 1e3  # [m]: what has no side; cancellation takes 1e-13 m


class Core(NamedTuple):
    """What stands for a shape.

    Attributes
    ----------
    numbers : ndarray, shape (CORE,)
        beta, lambda and epsilon.
    radius : float
        By which it is rounded [m].
    middle : float
        Where its middle is along z of the shape [m].
    """

    numbers: Array
    radius: float = 0.0
    middle: float = 0.0


def core_of(shape: str, sizes: Sequence[float] | Array, smoothing: float) -> Core:
    """Core of a shape.

    Parameters
    ----------
    shape : str
        A key of `mbocp.robot.collision.obstacle.SIZES`.
    sizes : sequence of float
        Sides of a box; radius, and length of a capsule (of its axis) or a cylinder [m].
    smoothing : float
        Epsilon [m].
    """
    e = smoothing
    if shape == "sphere":
        return Core(np.array([0.0, 0.0, 0.0, 0.0, e]), float(sizes[0]))
    if shape == "capsule":
        return Core(np.array([0.0, 0.0, np.hypot(sizes[1] / 2.0, e), 0.0, e]), float(sizes[0]))
    if shape == "cylinder":
        return Core(np.array([np.hypot(sizes[0], e), _BROAD, np.hypot(sizes[1] / 2.0, e), 1.0, e]))
    if shape == "halfspace":
        return Core(np.array([_BROAD, _BROAD, _BROAD, 0.0, e]), middle=-_BROAD)
    return Core(np.array([*np.hypot(np.asarray(sizes) / 2.0, e), 0.0, e]))


def distance_from_core(p: ca.SX, core: ca.SX) -> ca.SX:
    """Distance of a point from a core, negative inside [m].

    Parameters
    ----------
    p : casadi.SX, shape (3,)
        From the middle of the core, in the axes of the shape [m].
    core : casadi.SX, shape (CORE,)
    """
    e = core[4]
    across = ca.sqrt(p[0] ** 2 + core[3] * p[1] ** 2 + e**2)
    gaps = [across - core[0], _length(p[1], e) - core[1], _length(p[2], e) - core[2]]
    outside = ca.sqrt(sum((_positive(gap, e) ** 2 for gap in gaps), ca.SX(0)))
    return outside - _positive(-reduce(lambda a, b: _largest(a, b, e), gaps), e)


def _length(x: ca.SX, e: ca.SX) -> ca.SX:
    return ca.sqrt(x**2 + e**2)


def _positive(w: ca.SX, e: ca.SX) -> ca.SX:
    return (w + _length(w, e)) / 2


def _largest(a: ca.SX, b: ca.SX, e: ca.SX) -> ca.SX:
    return (a + b + _length(a - b, e)) / 2


def level_off(
    kept: ca.SX, distance: ca.SX, gradient: ca.SX, curvature: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Distance that is the same wherever it is large, with gradient and curvature, and whether it has these.

    Up to 10 cm beyond what is kept it is as given, from 18 cm on constant, with two continuous derivatives;
    where more than 1 m is kept, up to 10 % of that, and from 18 % on.

    Parameters
    ----------
    kept : casadi.SX
        The distance that a row keeps [m].
    distance : casadi.SX
        [m].
    gradient, curvature : casadi.SX, shapes (3,) and (3, 3)
        Of the distance, by the place.
    """
    size = ca.fmax(kept, 1)
    end, gap = kept + _AS_GIVEN * size, (_LEVEL - _AS_GIVEN) * size
    part = ca.fmin(ca.fmax((distance - end) / gap, 0), 1)
    first, second = 1 - part**2 * (3 - 2 * part), -6 * part * (1 - part) / gap
    level = ca.fmin(distance, end) + gap * (part - part**3 + part**4 / 2)
    return level, first * gradient, first * curvature + second * (gradient @ gradient.T), part < 1


PLANE = 4  # numbers of a plane
MOST_PLANES = 256
_LEAST_PLANES = 64
_NOWHERE = np.array([0.0, 0.0, 0.0, 1e3])  # a plane that is not needed: nothing is near it [m]


@dataclass(frozen=True, eq=False)
class HullCore:
    """What stands for a hull.

    Attributes
    ----------
    planes : ndarray, shape (M, PLANE)
        Unit normal outwards and offset [m].
    sharpness : float
        k [1/m].
    slope : float
        See `mbocp.robot.collision.planes.Planes`.
    """

    planes: Array
    sharpness: float
    slope: float

    radius: ClassVar[float] = 0.0  # nothing rounds it

    @classmethod
    def of(cls, normals: Array, offsets: Array, slope: float, smoothing: float) -> HullCore:
        """From planes, smoothed over a length [m]."""
        return cls(np.column_stack([normals, offsets]), float(np.log(len(offsets))) / smoothing, slope)

    def fill(self, slots: int) -> Array:
        """Planes of a table with room for more of them, shape (slots * PLANE,)."""
        return np.vstack([self.planes, np.tile(_NOWHERE, (slots - len(self.planes), 1))]).ravel()


def plane_slots(count: int) -> int:
    """Room for how many planes there is where some are needed: 64, 128, 256; so that few are compiled."""
    slots = _LEAST_PLANES
    while slots < count:
        slots *= 2
    return slots if count else 0


def hull_measure(slots: int) -> ca.Function:
    """(p, numbers) -> d, its gradient and its curvature; numbers are k and the planes, one after the other.

    Parameters
    ----------
    slots : int
        Room for planes.
    """
    p, numbers = ca.SX.sym("p", 3), ca.SX.sym("numbers", 1 + PLANE * slots)
    k, table = numbers[0], ca.reshape(numbers[1:], PLANE, slots)
    normals = [table[:3, i] for i in range(slots)]
    gaps = [ca.dot(n, p) - table[3, i] for i, n in enumerate(normals)]
    top = _tree(ca.fmax, gaps)
    powers = [ca.exp(k * (gap - top)) for gap in gaps]
    total = _tree(add, powers)
    weighed = list(zip(powers, normals, strict=True))
    slope = reduce(add, (w * n for w, n in weighed)) / total
    sides = [(i, j) for i in range(3) for j in range(i, 3)]
    spread = [reduce(add, (w * n[i] * n[j] for w, n in weighed)) / total for i, j in sides]
    xx, xy, xz, yy, yz, zz = spread
    mean = ca.vertcat(ca.horzcat(xx, xy, xz), ca.horzcat(xy, yy, yz), ca.horzcat(xz, yz, zz))
    outputs = [top + ca.log(total) / k, slope, k * (mean - slope @ slope.T)]
    return ca.Function("hull", [p, numbers], outputs)


def _tree(joined: Callable[[ca.SX, ca.SX], ca.SX], parts: list[ca.SX]) -> ca.SX:
    """All parts joined in pairs, and the pairs again."""
    while len(parts) > 1:
        pairs = [joined(a, b) for a, b in zip(parts[::2], parts[1::2], strict=False)]
        parts = pairs + parts[len(parts) - len(parts) % 2 :]
    return parts[0]
