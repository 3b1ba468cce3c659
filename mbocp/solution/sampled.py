"""A motion at any rate: cubics between the nodes, through their positions with their velocities."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue
from mbocp.solution.data import SolutionData
from mbocp.terms import RATE_TERMS

_LARGEST_RATE = 1e5  # [1/s]
_MOST_SAMPLES = 2_000_000
_BETWEEN = 10  # places between two nodes at which limits are looked at
_TOLERANCE = 1e-4  # relative, of a limit that is exceeded between nodes


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


def sample(solution: SolutionData, rate: float | None = None) -> Sampled:
    """Sample a motion.

    Parameters
    ----------
    solution : Solution
    rate : float, optional
        Samples a second [1/s], and the end; the nodes by default.

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
    q = np.column_stack([positions for positions, _ in columns.values()])
    v = solution.vs[:, [place for _, place in columns.values()]]
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
        *_cubics(nodes, q, v, step, times),
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


def excesses(solution: SolutionData, rate: float | None = None) -> tuple[Excess, ...]:
    """Limits of joints that the motion exceeds, the worst by its ratio first.

    Positions and speeds are those of the cubics, between nodes, too. Accelerations and jerks are differences
    of the sampled velocities, as a controller sees them.

    Parameters
    ----------
    solution : Solution
    rate : float, optional
        Samples a second [1/s]; the nodes by default.
    """
    columns = dict(_columns(solution))
    if not columns:
        return ()
    nodes = solution.t - solution.t[0]
    fine = np.unique(np.concatenate([np.linspace(a, b, _BETWEEN + 1) for a, b in pairwise(nodes)]))
    q = np.column_stack([positions for positions, _ in columns.values()])
    places = [place for _, place in columns.values()]
    positions, velocities, _ = _cubics(nodes, q, solution.vs[:, places], _steps_of(nodes, fine), fine)
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


def _cubics(nodes: Array, q: Array, v: Array, step: Array, times: Array) -> tuple[Array, Array, Array]:
    """Hermite's cubics and their first two derivatives."""
    h = np.diff(nodes)[step][:, None]
    h = np.where(h > 0.0, h, 1.0)
    s = (times - nodes[step])[:, None] / h
    q0, q1, v0, v1 = q[step], q[step + 1], v[step], v[step + 1]
    position = (
        (2 * s**3 - 3 * s**2 + 1) * q0
        + (s**3 - 2 * s**2 + s) * h * v0
        + (3 * s**2 - 2 * s**3) * q1
        + (s**3 - s**2) * h * v1
    )
    velocity = 6 * (s - s**2) * (q1 - q0) / h + (3 * s**2 - 4 * s + 1) * v0 + (3 * s**2 - 2 * s) * v1
    acceleration = 6 * (1 - 2 * s) * (q1 - q0) / h**2 + ((6 * s - 4) * v0 + (6 * s - 2) * v1) / h
    return position, velocity, acceleration
