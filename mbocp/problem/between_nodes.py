r"""What a motion does to limits of positions and speeds between its nodes, where nothing keeps them.

In a step of length h from (q_0, v_0) to (q_1, v_1), with the mean speed m = (q_1 - q_0) / h, the motion is
taken to be the cubic that has these four:

.. math:: v(s) = (1 - 4s + 3s^2)\, v_0 + (3s^2 - 2s)\, v_1 + 6s(1 - s)\, m, \qquad 0 \le s \le 1

It is what `mbocp export` sends, and agrees with the flow of the robot to the third order in h. Configurations
of schemes of first order are not that of the flow with their velocities: of these nothing is said.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mbocp._arrays import Array, IntArray
from mbocp.integrators import SCHEMES
from mbocp.problem.problem import Problem
from mbocp.robot import Robot

__all__ = ["GROSS_EXCESS", "LimitExcess", "is_followed", "largest_excess"]

GROSS_EXCESS = (
    0.05  # of a limit: what drives put up with for a moment; beyond, steps do not resolve the motion
)
_NONE = 1e-6  # part of a limit by which solvers may leave it


@dataclass(frozen=True)
class LimitExcess:
    """The largest excess of a limit between nodes.

    Attributes
    ----------
    kind : {"speed", "position"}
    name : str
        Of the joint's direction.
    value, bound : float
        There, and the limit that is left [unit].
    time : float
        [s].
    ratio : float
        Of the excess to the size of the limit: the larger side of a speed, the range of a position.
    unit : str
    """

    kind: str
    name: str
    value: float
    bound: float
    time: float
    ratio: float
    unit: str

    @property
    def of(self) -> str:
        """Which limit."""
        return f"{self.kind} of {self.name}"

    @property
    def words(self) -> str:
        """In a sentence."""
        return (
            f"between nodes the {self.of} is {self.value:.4g} {self.unit} at t = {self.time:.4g} s, "
            f"{100.0 * self.ratio:.3g} % beyond {self.bound:.4g}"
        )


def is_followed(problem: Problem) -> bool:
    """Whether the robot follows the cubics through the nodes, as far as steps resolve its motion."""
    return SCHEMES[problem.scheme].order > 1


def largest_excess(problem: Problem, t: Array, qs: Array, vs: Array) -> LimitExcess | None:
    """The largest excess of the limits of positions and speeds between nodes; None where none is known.

    Parameters
    ----------
    problem : Problem
    t : ndarray, shape (N + 1,)
        Times of the nodes [s].
    qs, vs : ndarray, shapes (N + 1, nq) and (N + 1, nv)
    """
    limits, robot = problem.limits_along(), problem.robot
    steps = np.flatnonzero(np.diff(t) > 0.0)  # impacts take no time
    has_limits = any(np.isfinite(side).any() for letter in "qv" for side in limits[letter])
    if not (
        is_followed(problem) and has_limits and steps.size and np.isfinite(qs).all() and np.isfinite(vs).all()
    ):
        return None
    lengths = np.diff(t)[steps, None]
    means = _differences(robot, qs)[steps] / lengths
    cubic = _Cubic(t[steps], lengths, vs[steps], vs[steps + 1], means)
    found = list(_of_speeds(problem, cubic, _sides(limits["v"], steps)))
    places = [(j.idx_q, j.idx_v) for j in robot.model.joints if j.nq == j.nv == 1]
    if places and np.isfinite(limits["q"][0]).any() | np.isfinite(limits["q"][1]).any():
        at_q, at_v = (list(numbers) for numbers in zip(*places, strict=True))
        lower, upper = (side[:, at_q] for side in _sides(limits["q"], steps))
        found += _of_positions(problem, cubic, qs[np.ix_(steps, at_q)], at_v, (lower, upper))
    return max((one for one in found if one.ratio > _NONE), key=lambda one: one.ratio, default=None)


@dataclass(frozen=True, eq=False)
class _Cubic:
    """Steps: begins [s], lengths, shape (n, 1) [s], speeds at both ends and their means, shape (n, nv)."""

    begins: Array
    lengths: Array
    v0: Array
    v1: Array
    means: Array

    def speeds(self, s: Array) -> Array:
        """At shares of the steps, shape (n, nv)."""
        return (1 - 4 * s + 3 * s**2) * self.v0 + (3 * s**2 - 2 * s) * self.v1 + 6 * s * (1 - s) * self.means

    def ways(self, s: Array) -> Array:
        """From the begins of the steps, at shares of them, shape (n, nv)."""
        weighed = (
            (s - 2 * s**2 + s**3) * self.v0 + (s**3 - s**2) * self.v1 + (3 * s**2 - 2 * s**3) * self.means
        )
        return self.lengths * weighed

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
    found: Array = np.where((s > 0.0) & (s < 1.0), s, 0.0)
    return found


def _differences(robot: Robot, qs: Array) -> Array:
    """What leads from node to node, shape (N, nv)."""
    if robot.is_vector_space:
        return np.diff(qs, axis=0)
    return np.array([robot.difference(a, b) for a, b in pairwise(qs)])


def _sides(limits: tuple[Array, Array], steps: IntArray) -> tuple[Array, Array]:
    """Limits within the steps, from those of the nodes 1..N: the wider ones of both ends."""
    count = int(steps[-1]) + 1
    lower, upper = (np.broadcast_to(side, (max(count, len(side)), side.shape[1])) for side in limits)
    before = np.maximum(steps - 1, 0)
    return np.minimum(lower[steps], lower[before]), np.maximum(upper[steps], upper[before])


def _of_speeds(problem: Problem, cubic: _Cubic, sides: tuple[Array, Array]) -> Iterator[LimitExcess]:
    s = cubic.extremes_of_speeds()
    size = np.maximum(*(np.where(np.isfinite(side), np.abs(side), 0.0) for side in sides))
    yield from _worst(problem, "speed", cubic.speeds(s), s, cubic, sides, size, range(problem.robot.nv))


def _of_positions(
    problem: Problem, cubic: _Cubic, begins: Array, at_v: list[int], sides: tuple[Array, Array]
) -> Iterator[LimitExcess]:
    widths = sides[1] - sides[0]
    largest = np.maximum(*(np.where(np.isfinite(side), np.abs(side), 0.0) for side in sides))
    size = np.where(np.isfinite(widths), widths, largest)
    for s in cubic.extremes_of_ways():
        values = begins + cubic.ways(s)[:, at_v]
        yield from _worst(problem, "position", values, s[:, at_v], cubic, sides, size, at_v)


def _worst(
    problem: Problem,
    kind: str,
    values: Array,
    s: Array,
    cubic: _Cubic,
    sides: tuple[Array, Array],
    size: Array,
    at_v: range | list[int],
) -> Iterator[LimitExcess]:
    """The largest excess of either side among values, shape (n, columns)."""
    for bound, over in ((sides[0], sides[0] - values), (sides[1], values - sides[1])):
        ratios = np.where(np.isfinite(bound), over, -np.inf) / np.maximum(size, 1e-9)
        n, k = np.unravel_index(int(ratios.argmax()), ratios.shape)
        if ratios[n, k] > 0.0:
            label = problem.robot.v_labels[at_v[k]]
            unit = label.unit if kind == "speed" else label.unit.removesuffix("/s")
            time = float(cubic.begins[n] + s[n, k] * cubic.lengths[n, 0])
            numbers = float(values[n, k]), float(bound[n, k]), time, float(ratios[n, k])
            yield LimitExcess(kind, label.name, *numbers, unit)
