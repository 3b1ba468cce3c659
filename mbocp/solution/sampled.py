r"""A motion at any rate: cubics or quintics between the nodes, through their positions with their velocities.

Cubics leap in their accelerations from step to step. Quintics have those accelerations a_n at the nodes that
leave the jerk continuous, and so its square smallest; with d_n what leads from node n - 1 to node n in a step
of length h_n, at every node within the motion

.. math::
    -\frac{3 a_{n-1}}{h_n} + 9 \Bigl(\frac{1}{h_n} + \frac{1}{h_{n+1}}\Bigr) a_n - \frac{3 a_{n+1}}{h_{n+1}}
    = \frac{60 d_{n+1}}{h_{n+1}^3} - \frac{36 v_n + 24 v_{n+1}}{h_{n+1}^2}
    - \frac{60 d_n}{h_n^3} + \frac{24 v_{n-1} + 36 v_n}{h_n^2}

Where a joint with limited jerk begins or ends at rest its acceleration is zero there, else its jerk is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_banded

from mbocp._arrays import Array, BoolArray
from mbocp.exceptions import InvalidValue
from mbocp.solution.data import SolutionData
from mbocp.terms import RATE_TERMS

INTERPOLATIONS = ("cubic", "quintic")
_LARGEST_RATE = 1e5  # [1/s]
_MOST_SAMPLES = 2_000_000
_BETWEEN = 10  # places between two nodes at which limits are looked at
_TOLERANCE = 1e-4  # relative, of a limit that is exceeded between nodes
_AT_REST = 1e-9  # [rad/s, m/s]


@dataclass(frozen=True, eq=False)
class Sampled:
    """Joints of one velocity along a motion; others (floating bases, balls) are left out.

    Parameters
    ----------
    t : ndarray, shape (K,)
        From the start of the motion [s].
    joints : tuple of str
        Names, in the order of the columns.
    units : tuple of str
        "rad" or "m".
    positions, velocities, accelerations : ndarray, shape (K, n)
        Continuous joints count their turns [rad, m, s].
    efforts : ndarray, shape (K, n)
        Controls of the same names, as the solution has them between nodes: constant over its steps, or
        polynomials; NaN where a joint has none [N m, N].
    left_out : tuple of str
        Joints that are not among them.
    """

    t: Array
    joints: tuple[str, ...]
    units: tuple[str, ...]
    positions: Array
    velocities: Array
    accelerations: Array
    efforts: Array
    left_out: tuple[str, ...]


def sample(
    solution: SolutionData, rate: float | None = None, interpolation: str = INTERPOLATIONS[0]
) -> Sampled:
    """Sample a motion.

    Parameters
    ----------
    solution : Solution
    rate : float, optional
        Samples a second [1/s], and the end; the nodes by default.
    interpolation : {"cubic", "quintic"}

    Raises
    ------
    InvalidValue
        If the rate cannot be right, or no joint has one velocity.
    """
    nodes = solution.t - solution.t[0]
    if rate is None:
        times = nodes
    else:
        if not (math.isfinite(rate) and 0.0 < rate <= _LARGEST_RATE):
            raise InvalidValue("rate", rate, f"samples a second, above 0 and up to {_LARGEST_RATE:g}")
        if nodes[-1] * rate > _MOST_SAMPLES:
            raise InvalidValue(
                "rate", rate, f"at most {_MOST_SAMPLES} samples of a motion of {nodes[-1]:g} s"
            )
        times = np.arange(0.0, nodes[-1], 1.0 / rate)
        times = np.append(times[nodes[-1] - times > 1e-9], nodes[-1])
    columns = dict(_columns(solution))
    if not columns:
        raise InvalidValue("solution", "no joint of one velocity", "joints that slide or turn about an axis")
    controls = {column.name: k for k, column in enumerate(solution.labels.u)}
    step = _steps_of(nodes, times)
    applied = solution.us[step]
    if not solution.has_constant_controls:
        applied = solution.controls_at(solution.t[0] + times)
    efforts = np.full((len(times), len(columns)), np.nan)
    for k, name in enumerate(columns):
        if name in controls:
            efforts[:, k] = applied[:, controls[name]]
    names = {column.name.partition(".")[0] for column in solution.labels.v}
    return Sampled(
        times,
        tuple(columns),
        tuple(solution.labels.v[place].unit.removesuffix("/s") for _, place in columns.values()),
        *_curves(solution, columns, interpolation).at(step, times)[:3],
        efforts,
        tuple(sorted(names - {name.partition(".")[0] for name in columns})),
    )


@dataclass(frozen=True)
class Excess:
    """The largest excess of a motion beyond a limit.

    Attributes
    ----------
    kind : {"position", "speed", "acceleration", "jerk"}
    name : str
        Of the joint.
    value, bound : float
        Where it is largest, and the limit [unit].
    time : float
        From the start of the motion [s].
    ratio : float
        Of the excess to the size of the limits, the larger one of both sides: 0.1 is a tenth too much.
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
    def words(self) -> str:
        """The excess without the joint's name."""
        return (
            f"{self.kind} {self.value:.4g} {self.unit} at {self.time:.4g} s, "
            f"{100.0 * self.ratio:.1f} % beyond {self.bound:.4g}"
        )


def excesses(
    solution: SolutionData, rate: float | None = None, interpolation: str = INTERPOLATIONS[0]
) -> tuple[Excess, ...]:
    """Limits of joints that the motion exceeds, the worst by its ratio first.

    Positions and speeds are those between nodes, too, and of quintics accelerations and jerks are. Those of
    cubics are differences of the sampled velocities, as a controller sees them.

    Parameters
    ----------
    solution : Solution
    rate : float, optional
        Samples a second [1/s]; the nodes by default.
    interpolation : {"cubic", "quintic"}
    """
    columns = dict(_columns(solution))
    if not columns:
        return ()
    nodes = solution.t - solution.t[0]
    fine = np.unique(np.concatenate([np.linspace(a, b, _BETWEEN + 1) for a, b in pairwise(nodes)]))
    places = [place for _, place in columns.values()]
    curves = _curves(solution, columns, interpolation)
    positions, velocities, accelerations, jerks = curves.at(_steps_of(nodes, fine), fine)
    at_accelerations = at_jerks = fine
    if curves.accelerations is None:
        samples = sample(solution, rate)
        accelerations, at_accelerations = _differences(samples.velocities, samples.t)
        jerks, at_jerks = _differences(accelerations, at_accelerations)
    facts = solution.facts
    q_places = {column.name: k for k, column in enumerate(solution.labels.q)}
    found: list[Excess] = []
    for k, name in enumerate(columns):
        of_v = solution.labels.v[places[k]].unit
        found += _over("speed", name, velocities[:, k], solution.limits_v[:, places[k]], fine, of_v)
        if name in q_places:
            bounds = solution.limits_q[:, q_places[name]]
            found += _over("position", name, positions[:, k], bounds, fine, of_v.removesuffix("/s"))
        for kind, values, t in (
            ("acceleration", accelerations, at_accelerations),
            ("jerk", jerks, at_jerks),
        ):
            if kind in facts.rates:
                unit = RATE_TERMS[kind].unit(of_v)
                found += _over(kind, name, values[:, k], facts.bounds_of_rate(kind)[:, places[k]], t, unit)
    return tuple(sorted(found, key=lambda excess: -excess.ratio))


def _over(kind: str, name: str, values: Array, bounds: Array, t: Array, unit: str) -> Iterator[Excess]:
    size = max(float(np.max(np.abs(bounds[np.isfinite(bounds)]), initial=0.0)), 1e-9)
    for bound, over in ((bounds[0], bounds[0] - values), (bounds[1], values - bounds[1])):
        if math.isfinite(bound) and over.size:
            worst = int(np.argmax(over))
            ratio = float(over[worst]) / size
            if ratio > _TOLERANCE:
                yield Excess(kind, name, float(values[worst]), float(bound), float(t[worst]), ratio, unit)


def _differences(values: Array, t: Array) -> tuple[Array, Array]:
    """Slopes between samples, and the times between these; none across an impact, which takes no time."""
    lengths = np.diff(t)
    takes_time = lengths > 0.0
    slopes = np.diff(values, axis=0)[takes_time] / lengths[takes_time, None]
    return slopes, (0.5 * (t[1:] + t[:-1]))[takes_time]


def _columns(solution: SolutionData) -> Iterator[tuple[str, tuple[Array, int]]]:
    """Positions at the nodes, and place in v, of each joint of one velocity."""
    places = {column.name: k for k, column in enumerate(solution.labels.q)}
    for place, column in enumerate(solution.labels.v):
        name = column.name
        if name in places:
            yield name, (solution.qs[:, places[name]], place)
        elif f"{name}.cos" in places and f"{name}.sin" in places:
            angle = np.arctan2(solution.qs[:, places[f"{name}.sin"]], solution.qs[:, places[f"{name}.cos"]])
            yield name, (np.unwrap(angle), place)


def _steps_of(nodes: Array, times: Array) -> Array:
    """Number of the step in which each time is; of two at an impact the later."""
    found: Array = np.clip(np.searchsorted(nodes, times, side="right") - 1, 0, len(nodes) - 2)
    lengths = np.diff(nodes)
    while (lengths[found] == 0.0).any() and (found > 0).any():  # an impact at the end
        found = np.where(lengths[found] == 0.0, np.maximum(found - 1, 0), found)
    return found


@dataclass(frozen=True, eq=False)
class _Curves:
    """Polynomials between nodes: cubics, or quintics where accelerations at the nodes are given."""

    nodes: Array
    q: Array
    v: Array
    accelerations: Array | None

    def at(self, step: Array, times: Array) -> tuple[Array, Array, Array, Array]:
        """Positions and their first three derivatives."""
        h = np.diff(self.nodes)[step][:, None]
        h = np.where(h > 0.0, h, 1.0)
        s = (times - self.nodes[step])[:, None] / h
        q0, v0, v1 = self.q[step], h * self.v[step], h * self.v[step + 1]
        d = self.q[step + 1] - q0
        if self.accelerations is None:
            c: tuple[Array, ...] = (v0, 3 * d - 2 * v0 - v1, v0 + v1 - 2 * d)
        else:
            a0, a1 = h**2 * self.accelerations[step], h**2 * self.accelerations[step + 1]
            c = (
                v0,
                a0 / 2,
                10 * d - 6 * v0 - 4 * v1 - (3 * a0 - a1) / 2,
                -15 * d + 8 * v0 + 7 * v1 + (3 * a0 - 2 * a1) / 2,
                6 * d - 3 * v0 - 3 * v1 - (a0 - a1) / 2,
            )
        powers = range(1, len(c) + 1)
        position = q0 + sum(c[k - 1] * s**k for k in powers)
        velocity = sum(k * c[k - 1] * s ** (k - 1) for k in powers) / h
        acceleration = sum(k * (k - 1) * c[k - 1] * s ** max(k - 2, 0) for k in powers) / h**2
        jerk = sum(k * (k - 1) * (k - 2) * c[k - 1] * s ** max(k - 3, 0) for k in powers) / h**3
        return position, velocity, acceleration, jerk


def _curves(solution: SolutionData, columns: dict[str, tuple[Array, int]], interpolation: str) -> _Curves:
    if interpolation not in INTERPOLATIONS:
        raise InvalidValue.of_choice("interpolation", interpolation, INTERPOLATIONS)
    nodes, places = solution.t - solution.t[0], [place for _, place in columns.values()]
    q, v = np.column_stack([positions for positions, _ in columns.values()]), solution.vs[:, places]
    if interpolation == "cubic":
        return _Curves(nodes, q, v, None)
    has_jerk: BoolArray = np.zeros(len(places), dtype=np.bool_)
    if "jerk" in solution.facts.rates:
        has_jerk |= np.isfinite(solution.facts.bounds_of_rate("jerk")[:, places]).any(axis=0)
    accelerations = np.zeros_like(v)
    leaps = [0, *(int(n) + 1 for n in np.flatnonzero(np.diff(nodes) == 0.0)), len(nodes)]
    for first, last in pairwise(leaps):  # an impact has another velocity on each side
        part = slice(first, last)
        accelerations[part] = _smoothest(nodes[part], q[part], v[part], has_jerk)
    return _Curves(nodes, q, v, accelerations)


def _smoothest(t: Array, q: Array, v: Array, has_jerk: BoolArray) -> Array:
    """Accelerations at the nodes whose quintics have continuous jerks, shape (n, joints)."""
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
        if has_jerk[k] and abs(v[0, k]) < _AT_REST:
            own[1, 0], own[0, 1], b[0] = 1.0, 0.0, 0.0
        if has_jerk[k] and abs(v[-1, k]) < _AT_REST:
            own[1, -1], own[2, -2], b[-1] = 1.0, 0.0, 0.0
        found[:, k] = solve_banded((1, 1), own, b)
    return found
