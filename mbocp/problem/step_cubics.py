r"""Steps as the cubics through their nodes.

In a step of length h from (q_0, v_0) to (q_1, v_1), with the mean speed m = (q_1 - q_0) / h, the motion is
taken to be the cubic that has these four:

.. math:: v(s) = (1 - 4s + 3s^2)\, v_0 + (3s^2 - 2s)\, v_1 + 6s(1 - s)\, m, \qquad 0 \le s \le 1

It is what `mbocp export` sends, and agrees with the flow of the robot to the third order in h. Configurations
of schemes of first order are not that of the flow with their velocities: of these nothing is said.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.robot import Robot


@dataclass(frozen=True, eq=False)
class StepCubics:
    """Steps as cubics.

    Attributes
    ----------
    begins, lengths : ndarray, shape (n, 1), or symbols of one step
        [s].
    v0, v1, means : ndarray, shape (n, nv), or casadi.SX, shape (nv,)
        Speeds at both ends, and their means [m/s, rad/s].
    """

    begins: Any
    lengths: Any
    v0: Any
    v1: Any
    means: Any

    @classmethod
    def through(cls, robot: Robot, t: Array, qs: Array, vs: Array) -> StepCubics:
        """Of all steps that take time, from the nodes of a motion."""
        steps = np.flatnonzero(np.diff(t) > 0.0)
        lengths = np.diff(t)[steps, None]
        if robot.is_vector_space:
            ways = qs[steps + 1] - qs[steps]
        else:
            ways = np.array([robot.difference(qs[n], qs[n + 1]) for n in steps]).reshape(-1, robot.nv)
        return cls(t[steps, None], lengths, vs[steps], vs[steps + 1], ways / lengths)

    def times(self, s: Array) -> Array:
        """At shares of the steps [s]."""
        return self.begins + s * self.lengths

    def speeds(self, s: Any) -> Any:
        """At shares of the steps, shape (n, nv)."""
        return (1 - 4 * s + 3 * s**2) * self.v0 + (3 * s**2 - 2 * s) * self.v1 + 6 * s * (1 - s) * self.means

    def ways(self, s: Any) -> Any:
        """From the begins of the steps, at shares of them, shape (n, nv)."""
        weighed = (
            (s - 2 * s**2 + s**3) * self.v0 + (s**3 - s**2) * self.v1 + (3 * s**2 - 2 * s**3) * self.means
        )
        return self.lengths * weighed

    def accelerations(self, s: float) -> Array:
        """At a share of the steps, shape (n, nv); they are extreme at both ends."""
        return ((6 * s - 4) * self.v0 + (6 * s - 2) * self.v1 + (6 - 12 * s) * self.means) / self.lengths

    def extremes_of_speeds(self) -> Array:
        """Shares at which speeds are extreme, 0 where that is not within a step."""
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (4 * self.v0 + 2 * self.v1 - 6 * self.means) / (6 * self.v0 + 6 * self.v1 - 12 * self.means)
        return _within(s)

    def extremes_of_ways(self) -> tuple[Array, Array]:
        """Shares at which speeds are zero."""
        a, c = 3 * self.v0 + 3 * self.v1 - 6 * self.means, self.v0
        b = 6 * self.means - 4 * self.v0 - 2 * self.v1
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(b**2 - 4 * a * c)
            larger = -(b + np.where(b < 0.0, -1.0, 1.0) * root) / 2.0
            return _within(larger / a), _within(c / larger)


def _within(s: Array) -> Array:
    return np.where((s > 0.0) & (s < 1.0), s, 0.0)


def move_along(robot: Robot, qs: Array, ways: Array) -> Array:
    """Configurations at tangent vectors from others, shape (n, nq)."""
    if robot.is_vector_space:
        return qs + ways
    return np.array([robot.integrate(q, way) for q, way in zip(qs, ways, strict=True)])
