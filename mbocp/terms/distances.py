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
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbocp._arrays import Array

CORE = 5  # numbers of a core
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
