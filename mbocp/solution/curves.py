r"""Polynomials between nodes: cubics or quintics through positions with their velocities.

Cubics leap in their accelerations from step to step. Quintics have those accelerations a_n at the nodes that
leave the jerk continuous, and so its square smallest; with d_n what leads from node n - 1 to node n in a step
of length h_n, at every node within the motion

.. math::
    -\frac{3 a_{n-1}}{h_n} + 9 \Bigl(\frac{1}{h_n} + \frac{1}{h_{n+1}}\Bigr) a_n - \frac{3 a_{n+1}}{h_{n+1}}
    = \frac{60 d_{n+1}}{h_{n+1}^3} - \frac{36 v_n + 24 v_{n+1}}{h_{n+1}^2}
    - \frac{60 d_n}{h_n^3} + \frac{24 v_{n-1} + 36 v_n}{h_n^2}

A spline is the cubics whose accelerations are continuous; its velocities differ from the motion's by what
steps are wrong by. The moving mean of cubics over a time w,

.. math:: \bar q(t) = \frac 1 w \int_{t - w/2}^{t + w/2} q(s) \, ds,

keeps all limits of positions, speeds and accelerations that the cubics keep, and has the jerk
(a(t + w/2) - a(t - w/2)) / w. It is of order four between the nodes moved by w/2 to either side: quintics
through these are the mean itself.

Under SE1 a velocity is that of the whole step before, v_n = (q_n - q_{n-1}) / h, and cubics through the nodes
take four times the accelerations of the scheme. At the middles of the steps, (q_{n-1} + q_n) / 2 with v_n,
cubics are parabolas with the scheme's own accelerations a_n = (v_n - v_{n-1}) / h. From rest they begin half
a step before the motion. Where it begins with a velocity there is nothing before. At its start the parabolas
have the velocity v_0 + a_1 h / 2 and are a_1 h^2 / 8 ahead of q_0; a cubic in time takes both away and fades
within ten steps. It adds up to a fifth of a_1, and leads the motion by up to 0.8 a_1 h^2 beside its nodes.
Nothing keeps the scheme's accelerations there: with -A it comes from v_0 to rest on a way of
v_0^2 / 2A - h v_0 / 2, and every other motion needs v_0^2 / 2A.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from mbocp._arrays import Array, BoolArray, IntArray, dataclass
from mbocp.robot.nodes import are_chords

Derivatives: TypeAlias = tuple[Array, Array, Array, Array]

AT_REST = 1e-6  # [rad/s, m/s]: ends are met to the tolerance of a solver
_SMALL_LEAP = 0.05  # of the largest speed of joints, as other excesses between nodes that are let pass
_STEPS_TO_MIDDLES = 10  # in which a motion that begins with a velocity comes to the middles of its steps
_GAUSS = (0.5 - 0.5 / 3**0.5, 0.5 + 0.5 / 3**0.5)
# By which nodes of a mean are apart, a part of its width at most: jerks have round-off by the cube of it.
_NEAREST, _PART = 5e-5, 0.1  # [s], 1


@dataclass(frozen=True, eq=False)
class Curves:
    """Cubics between nodes, or quintics where accelerations at the nodes are given.

    Attributes
    ----------
    nodes : ndarray, shape (n,)
        Times from the start of the motion [s]; an impact stands twice.
    q, v : ndarray, shape (n, joints)
    accelerations : ndarray, shape (n, joints), optional
    """

    nodes: Array
    q: Array
    v: Array
    accelerations: Array | None = None

    @property
    def interpolation(self) -> str:
        """What they are."""
        return "cubic" if self.accelerations is None else "quintic"

    @property
    def has_impacts(self) -> bool:
        """Whether velocities leap."""
        return bool((np.diff(self.nodes) == 0.0).any())

    def without_small_leaps(self, units: Sequence[str]) -> Curves:
        """Those that go on with the velocity after a leap which is within what steps are wrong by."""
        largest, kinds = np.abs(self.v).max(axis=0), np.array(units)
        sizes = [max(_SMALL_LEAP * float(largest[kinds == kind].max()), AT_REST) for kind in units]
        is_small = (np.abs(np.diff(self.v, axis=0)) <= sizes).all(axis=1)
        kept = np.append((np.diff(self.nodes) > 0.0) | ~is_small, True)
        return Curves(self.nodes[kept], self.q[kept], self.v[kept])

    @property
    def rests(self) -> IntArray:
        """Nodes on the way at which all joints come to rest, or begin to move again."""
        rests = np.abs(self.v).max(axis=1) < AT_REST
        return 1 + np.flatnonzero(rests[1:-1] & ~(rests[:-2] & rests[2:]))

    @property
    def has_chords(self) -> bool:
        """Whether velocities are those of the whole steps before, as of SE1."""
        return are_chords(np.diff(self.q, axis=0), self.nodes, self.v)

    @property
    def begins_at_rest(self) -> bool:
        """Whether all joints do."""
        return bool(np.abs(self.v[0]).max() < AT_REST)

    @property
    def is_from_rest_to_rest(self) -> bool:
        """Whether all joints begin and end at rest."""
        return bool(np.abs(self.v[[0, -1]]).max() < AT_REST)

    def at(self, times: Array) -> Derivatives:
        """Positions and their first three derivatives, shapes (k, joints)."""
        step = self.steps_of(times)
        return self._in_steps(step, (times - self.nodes[step]) / self._lengths()[step])

    def places(self, parts: int) -> tuple[Array, Derivatives]:
        """Times, and derivatives, at both ends of each step and between them."""
        steps = np.repeat(np.flatnonzero(np.diff(self.nodes) > 0.0), parts + 1)
        shares = np.tile(np.linspace(0.0, 1.0, parts + 1), len(steps) // (parts + 1))
        return self.nodes[steps] + shares * self._lengths()[steps], self._in_steps(steps, shares)

    def steps_of(self, times: Array) -> IntArray:
        """Number of the step in which each time is; of two at an impact the later."""
        found: IntArray = np.clip(
            np.searchsorted(self.nodes, times, side="right") - 1, 0, len(self.nodes) - 2
        )
        lengths = np.diff(self.nodes)
        while (lengths[found] == 0.0).any() and (found > 0).any():  # an impact at the end
            found = np.where(lengths[found] == 0.0, np.maximum(found - 1, 0), found)
        return found

    def smooth(self, has_jerk: BoolArray) -> Curves:
        """Quintics of the smoothest accelerations; those with a limited jerk have none where they rest."""
        accelerations = np.zeros_like(self.v)
        leaps = [0, *(int(n) + 1 for n in np.flatnonzero(np.diff(self.nodes) == 0.0)), len(self.nodes)]
        for first, last in pairwise(leaps):  # an impact has another velocity on each side
            part = slice(first, last)
            accelerations[part] = _smoothest(self.nodes[part], self.q[part], self.v[part], has_jerk)
        return replace(self, accelerations=accelerations)

    def through_middles(self) -> tuple[Curves, float]:
        """Cubics through the middles of the steps of a motion that `has_chords`.

        Returns
        -------
        curves : Curves
        lag : float
            How long before the motion they begin [s]: half a step, or not at all where it begins moving.
        """
        lengths = np.diff(self.nodes)
        lag = float(lengths[0]) / 2.0 if self.begins_at_rest else 0.0
        middles = self.nodes[:-1] + lengths / 2.0
        nodes = [middles[:1] - lengths[:1] / 2.0 - lag, middles, self.nodes[-1:]]
        positions = [self.q[:1], (self.q[:-1] + self.q[1:]) / 2.0, self.q[-1:]]
        velocities = [self.v[:1], self.v[1:], self.v[-1:]]
        if np.abs(self.v[-1]).max() < AT_REST:  # the last step leads nowhere
            nodes, positions, velocities = nodes[:-1], positions[:-1], velocities[:-1]
        times = np.concatenate(nodes)
        found = Curves(times - times[0], np.concatenate(positions), np.concatenate(velocities))
        return (found if self.begins_at_rest else found._begin_with(float(lengths[0]))), lag

    def _begin_with(self, length: float) -> Curves:
        """What comes from the state at the start to the middles of steps, the first of a length [s]."""
        change = self.v[1] - self.v[0]
        within = self.nodes[min(_STEPS_TO_MIDDLES, len(self.nodes) - 1)]
        s = np.clip(self.nodes / within, 0.0, 1.0)[:, None]
        ahead, faster = length * change / 8.0, change / 2.0
        q = self.q - ahead * (1.0 + 2.0 * s) * (1.0 - s) ** 2 - faster * within * s * (1.0 - s) ** 2
        v = self.v + ahead * 6.0 * s * (1.0 - s) / within - faster * (1.0 - s) * (1.0 - 3.0 * s)
        return Curves(self.nodes, np.vstack([self.q[:1], q[1:]]), np.vstack([self.v[:1], v[1:]]))

    def spline(self) -> Curves:
        """The cubic spline through the positions, with the velocities of both ends and of rests between."""
        from scipy.interpolate import CubicSpline  # slow to import, and no solve wants it

        v = self.v.copy()
        for part in self._from_rest_to_rest():
            t, q, ends = self.nodes[part], self.q[part], ((1, v[part][0]), (1, v[part][-1]))
            v[part] = CubicSpline(t, q, bc_type=ends)(t, 1)
        return Curves(self.nodes, self.q, v)

    def mean(self, width: float) -> Curves:
        """The moving mean over a time [s] of cubics from rest to rest, longer by that time for each rest."""
        parts = [Curves(self.nodes[k], self.q[k], self.v[k]) for k in self._from_rest_to_rest()]
        means = [part._mean(width, after=k * width) for k, part in enumerate(parts)]
        rows = ([one[min(k, 1) :] for k, one in enumerate(of)] for of in zip(*means, strict=True))
        nodes, *values = map(np.concatenate, rows)  # the node between two parts is that of the former
        return Curves(nodes - nodes[0], *values)

    def _from_rest_to_rest(self) -> list[slice]:
        """Nodes of the motion from each rest to the next."""
        return [slice(first, last + 1) for first, last in pairwise((0, *self.rests, len(self.nodes) - 1))]

    def _mean(self, width: float, after: float) -> tuple[Array, ...]:
        """Nodes, positions, velocities and accelerations."""
        nodes = np.unique(np.concatenate([self.nodes, self.nodes + width]))  # the mean ends at its time
        nodes = nodes[np.diff(nodes, prepend=-np.inf) > min(_PART * width, _NEAREST)]
        nodes[-1] = self.nodes[-1] + width
        lengths = np.diff(nodes)
        # Between two nodes the speed is cubic: two places integrate it.
        within = [nodes[:-1] + share * lengths for share in _GAUSS]
        ways = np.mean([self._leads(times, width)[0] for times in within], axis=0) * lengths[:, None]
        q = self.q[0] + np.vstack([np.zeros_like(self.q[:1]), np.cumsum(ways, axis=0)])
        return after + nodes, q, *self._leads(nodes, width)

    def slow(self, factor: float) -> Curves:
        """The same way in more time."""
        a = None if self.accelerations is None else self.accelerations / factor**2
        return Curves(factor * self.nodes, self.q, self.v / factor, a)

    def _lengths(self) -> Array:
        lengths = np.diff(self.nodes)
        return np.where(lengths > 0.0, lengths, 1.0)

    def _leads(self, times: Array, width: float) -> tuple[Array, Array]:
        """By how much positions and velocities lead those of a time before, by that time; at rest outside."""
        late, early = (self.at(np.clip(one, self.nodes[0], self.nodes[-1])) for one in (times, times - width))
        return (late[0] - early[0]) / width, (late[1] - early[1]) / width

    def _in_steps(self, step: IntArray, shares: Array) -> Derivatives:
        h, s, c = self._lengths()[step][:, None], shares[:, None], self._coefficients(step)
        found = []
        for order in range(4):
            terms = (
                float(np.prod(range(k - order + 1, k + 1))) * c[k] * s ** (k - order)
                for k in range(order, len(c))
            )
            found.append(sum(terms, start=np.zeros_like(c[0])) / h**order)
        return found[0], found[1], found[2], found[3]

    def _coefficients(self, step: IntArray) -> tuple[Array, ...]:
        """Of the powers of the share of a step."""
        h = self._lengths()[step][:, None]
        q0, v0, v1 = self.q[step], h * self.v[step], h * self.v[step + 1]
        d = self.q[step + 1] - q0
        if self.accelerations is None:
            return q0, v0, 3 * d - 2 * v0 - v1, v0 + v1 - 2 * d
        a0, a1 = h**2 * self.accelerations[step], h**2 * self.accelerations[step + 1]
        return (
            q0,
            v0,
            a0 / 2,
            10 * d - 6 * v0 - 4 * v1 - (3 * a0 - a1) / 2,
            -15 * d + 8 * v0 + 7 * v1 + (3 * a0 - 2 * a1) / 2,
            6 * d - 3 * v0 - 3 * v1 - (a0 - a1) / 2,
        )


def _smoothest(t: Array, q: Array, v: Array, has_jerk: BoolArray) -> Array:
    """Accelerations at the nodes whose quintics have continuous jerks, shape (n, joints)."""
    from scipy.linalg import solve_banded  # slow to import, and no solve wants it

    if len(t) < 2:
        return np.zeros_like(v)
    h = np.diff(t)[:, None]
    d = np.diff(q, axis=0)
    begins = 60 * d / h**3 - (36 * v[:-1] + 24 * v[1:]) / h**2  # jerks of the steps but for accelerations
    ends = 60 * d / h**3 - (24 * v[:-1] + 36 * v[1:]) / h**2
    right = np.zeros_like(v)
    right[:-1] += begins
    right[1:] -= ends
    bands = np.zeros((3, len(t)))
    bands[1, :-1] += 9 / h[:, 0]
    bands[1, 1:] += 9 / h[:, 0]
    bands[0, 1:] = bands[2, :-1] = -3 / h[:, 0]
    found = np.empty_like(v)
    for k in range(v.shape[1]):
        own, b = bands.copy(), right[:, k].copy()
        if has_jerk[k] and abs(v[0, k]) < AT_REST:
            own[1, 0], own[0, 1], b[0] = 1.0, 0.0, 0.0
        if has_jerk[k] and abs(v[-1, k]) < AT_REST:
            own[1, -1], own[2, -2], b[-1] = 1.0, 0.0, 0.0
        found[:, k] = solve_banded((1, 1), own, b)
    return found


def differences(values: Array, t: Array) -> tuple[Array, Array]:
    """Slopes between samples, and the times [s] between these; none across an impact, which takes no time."""
    lengths = np.diff(t)
    takes_time = lengths > 0.0
    slopes = np.diff(values, axis=0)[takes_time] / lengths[takes_time, None]
    return slopes, (0.5 * (t[1:] + t[:-1]))[takes_time]
