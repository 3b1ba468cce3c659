r"""Distance of a point from a convex hull, smooth everywhere, for path constraints.

A hull is planes that touch it, :math:`n_i \cdot p \le b_i`, see `mbocp.robot.collision.planes`: the largest
:math:`g_i = n_i \cdot p - b_i` is the distance outside and less the depth inside, too small by a stated error
beyond edges and corners. Its smooth form

.. math:: d = \tfrac1k \log \textstyle\sum_i e^{k g_i}, \qquad k = \log(M) / \varepsilon

of M planes is larger than it by :math:`\varepsilon` at most, where all planes are equally far, and by nothing
next to a side. With :math:`w_i = e^{k g_i} / \sum_j e^{k g_j}` its gradient is :math:`\sum_i w_i n_i` and its
curvature :math:`k (\sum_i w_i n_i n_i^T - \nabla d \nabla d^T)`, so that d is convex. Planes are numbers;
functions depend on how many there is room for.

A sum over planes was chosen over the projection onto the hull, whose second derivatives jump wherever the
nearest face, edge or corner changes, and over the largest distance from the faces alone, which beyond a
corner of a cube is 0.58 of the true one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import ClassVar

import casadi as ca
import numpy as np

from mbocp._arrays import Array

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
