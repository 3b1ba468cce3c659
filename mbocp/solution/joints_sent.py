"""Joints of a motion as it is sent to a controller: their curves, and the limits that these leave."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp._tolerances import PATH_TOLERANCE_PART, PATH_TOLERANCES
from mbocp.exceptions import InvalidValue
from mbocp.solution.curves import AT_REST, Curves, differences
from mbocp.solution.nearest import Ends
from mbocp.solution.problem_facts import BrakingPlace
from mbocp.solution.solution_data import SolutionData
from mbocp.terms.rates import RATE_TERMS

_PARTS = 10  # of a step at whose ends limits are looked at
_TOLERANCE = 1e-4  # relative, of a limit that is exceeded between nodes
CURVE_PART = 0.01  # the same where polynomials between nodes are no closer to the dynamics
FITTED = 1e-7  # relative, by which a motion that is fitted may leave a limit, as solvers may
_LEAST_SIZE = 1e-9  # of a limit
_SAME = 1e-9  # [s]
EFFORT_RATE = "effort rate"
_OF_CONTROLS = ("effort", EFFORT_RATE, "power", "root mean square")
_POWERS = {"speed": 1, "acceleration": 2, "jerk": 3}  # of the duration, that they fall with


@dataclass(frozen=True)
class Excess:
    """The largest excess of a motion beyond a limit.

    Attributes
    ----------
    kind : str
        "position", "speed", "acceleration", "jerk", "effort", "effort rate", "power", "root mean square" or
        "path".
    name : str
        Of the joint, the control, or the row of a path constraint.
    value, bound : float
        Where it is largest, and the limit [unit].
    time : float
        From the start of the motion [s].
    ratio : float
        Of the excess to the size of the limits, the larger one of both sides: 0.1 is a tenth too much.
        Of paths in [m] and [rad] the excess itself.
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
    def falls_with_speed(self) -> bool:
        """Whether a slower motion on the same way has less of it, but for the weight."""
        is_rate = (
            self.kind == "path" and self.unit not in PATH_TOLERANCES and abs(self.value) > abs(self.bound)
        )
        return self.kind in _OF_CONTROLS or is_rate

    @property
    def over_tolerance(self) -> float:
        """How many times what a path constraint may be left by it is."""
        return (
            self.ratio / PATH_TOLERANCES.get(self.unit, PATH_TOLERANCE_PART) if self.kind == "path" else 0.0
        )

    @property
    def words(self) -> str:
        """The excess without the name."""
        if self.kind == "path":
            over = abs(self.value - self.bound)
            return f"{self.value:.4g} {self.unit} at {self.time:.4g} s, {over:.2g} beyond {self.bound:.4g}"
        percent = 100.0 * self.ratio
        part = f"{percent:.1f}" if percent >= 1.0 else f"{percent:.1g}"
        return (
            f"{self.kind} {self.value:.4g} {self.unit} at {self.time:.4g} s, {part} % beyond {self.bound:.4g}"
        )


@dataclass(frozen=True, eq=False)
class Joints:
    """Joints of one velocity: names, units of their velocities, limits, ends, whether samples are joined.

    Limits are lower and upper ones by kind, shape (2, joints), infinite where there are none.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    bounds: Mapping[str, Array]
    braking: tuple[tuple[BrakingPlace, ...], ...]
    ends: Ends
    is_joined: bool

    def rest(self, curves: Curves) -> bool:
        """Whether all joints begin and end at rest, and with no acceleration."""
        return curves.is_from_rest_to_rest and not np.nan_to_num(self.ends.accelerations).any()

    def unit(self, kind: str, k: int) -> str:
        """Of a joint's values of a kind."""
        if kind in RATE_TERMS:
            return RATE_TERMS[kind].unit(self.units[k])
        return self.units[k] if kind == "speed" else self.units[k].removesuffix("/s")

    def factor(self, curves: Curves, rate: float | None) -> float:
        """By which curves have to be slower to keep limits of speeds, accelerations, jerks; 1 if they do."""
        worst, rows = 1.0, self._rows(curves, rate)
        for kind, power in _POWERS.items():
            if kind in self.bounds and len(rows[kind][0]):
                (lower, upper), (values, _) = self.bounds[kind], rows[kind]
                size = np.abs(np.where(np.isfinite(self.bounds[kind]), self.bounds[kind], 0.0)).max(axis=0)
                over = np.maximum(lower - values.min(axis=0), values.max(axis=0) - upper)
                ratio = float((over / np.maximum(size, _LEAST_SIZE)).max())
                worst = max(worst, (1.0 + ratio) ** (1.0 / power) if ratio > FITTED else 1.0)
        return float(worst)

    def excesses(self, curves: Curves, rate: float | None) -> tuple[Excess, ...]:
        """The largest of each limit along curves."""
        return tuple(
            excess
            for kind, (values, times) in self._rows(curves, rate).items()
            if kind in self.bounds
            for k, name in enumerate(self.names)
            for excess in find_excesses(
                kind, name, values[:, k], self.bounds[kind][:, k], times, self.unit(kind, k)
            )
        )

    def _rows(self, curves: Curves, rate: float | None) -> dict[str, tuple[Array, Array]]:
        """Values and times by kind; jerks of cubics are those of samples.

        So are their accelerations at nodes alone, which say nothing of what is between them.
        """
        t, (positions, velocities, accelerations, jerks) = curves.places(_PARTS)
        at_accelerations = at_jerks = t
        if curves.accelerations is None:
            times = sample_times(curves, rate)
            places, speeds = curves.at(times)[:2]
            if rate is None and not self.is_joined:
                accelerations, at_accelerations = differences(speeds, times)
            if rate is not None and len(times) > 2:  # a sample before, and one after
                changes, rests = np.diff(speeds, axis=0), np.abs(speeds[-1]) < AT_REST
                given = self.ends.accelerations / rate
                before = speeds[0] - np.where(np.isfinite(given), given, changes[0])
                after = np.where(rests, 0.0, speeds[-1] + changes[-1] / (times[-1] - times[-2]) / rate)
                times = np.concatenate([[-1.0 / rate], times, [times[-1] + 1.0 / rate]])
                speeds = np.vstack([before, speeds, after])
            jerks, at_jerks = differences(*differences(speeds, times))
            if rate is not None:  # controllers that are sent positions see their third differences
                third, thirds = _third_differences(places[:-1], rate)
                jerks, at_jerks = np.vstack([jerks, third]), np.append(at_jerks, thirds)
        return {
            "position": (positions, t),
            "speed": (velocities, t),
            "acceleration": (accelerations, at_accelerations),
            "jerk": (jerks, at_jerks),
        }


def _third_differences(positions: Array, rate: float) -> tuple[Array, Array]:
    """Of samples from the start on, all as far apart, and their times [s]."""
    third = np.diff(positions, 3, axis=0) * rate**3
    return third, np.arange(1.5, len(third) + 1.0) / rate


def read_joints(solution: SolutionData, *, is_joined: bool) -> tuple[Joints, Curves, float]:
    """Joints, cubics, and by how much these lag behind the nodes [s]."""
    columns = list(_columns(solution))
    if not columns:
        expected = (
            "joints that slide or turn about an axis: floating bases and balls have no joint trajectory; "
            "`mbocp export --format multidof`, or to .mcap or .rrd, and Solution.to_csv in Python, write "
            "their motion"
        )
        raise InvalidValue("solution", "no joint of one velocity", expected)
    names, positions, at_v = (list(one) for one in zip(*columns, strict=True))
    places = {column.name: k for k, column in enumerate(solution.labels.q)}
    free = np.array([[-np.inf], [np.inf]])  # continuous joints
    of_q = [solution.limits_q[:, places[name], None] if name in places else free for name in names]
    bounds = {"position": np.hstack(of_q), "speed": solution.limits_v[:, at_v]}
    rates = [kind for kind in ("acceleration", "jerk") if kind in solution.facts.rates]
    bounds |= {kind: solution.facts.bounds_of_rate(kind)[:, at_v] for kind in rates}
    units = tuple(solution.labels.v[place].unit for place in at_v)
    curves = Curves(solution.t - solution.t[0], np.column_stack(positions), solution.vs[:, at_v])
    curves = curves.without_small_leaps(units)
    lag = 0.0
    if curves.has_chords and not curves.has_impacts:
        curves, lag = curves.through_middles()
    has_jerk = (
        np.isfinite(bounds["jerk"]).any(axis=0) if "jerk" in bounds else np.zeros(len(names), dtype=bool)
    )
    braking = tuple(tuple(one for one in solution.facts.braking if one.joint == name) for name in names)
    accelerations = np.array(solution.facts.a_start or np.zeros(solution.nv))[at_v]
    is_asked = np.array(solution.facts.q_goal or np.ones(solution.nv))[at_v].astype(bool)
    ends = Ends(
        np.where(has_jerk, accelerations, np.nan), is_asked, has_jerk & (np.abs(curves.v[-1]) < AT_REST)
    )
    return Joints(tuple(names), units, bounds, braking, ends, is_joined), curves, lag


def _columns(solution: SolutionData) -> Iterator[tuple[str, Array, int]]:
    """Name, positions at the nodes, and place in v, of joints of one velocity; of motors of elastic ones."""
    places = {column.name: k for k, column in enumerate(solution.labels.q)}
    at_v = {column.name: k for k, column in enumerate(solution.labels.v)}
    motors = {joint: motor for joint, motor in solution.facts.elastic.items() if motor in at_v}
    for joint in (name for name in at_v if name not in motors.values()):
        name = motors.get(joint, joint)
        place = at_v[name]
        if name in places:
            yield name, solution.qs[:, places[name]], place
        elif f"{name}.cos" in places and f"{name}.sin" in places:
            angle = np.arctan2(solution.qs[:, places[f"{name}.sin"]], solution.qs[:, places[f"{name}.cos"]])
            yield name, np.unwrap(angle), place


def sample_times(curves: Curves, rate: float | None) -> Array:
    """Of samples, and of the end [s]."""
    if rate is None:
        return curves.nodes
    times = np.arange(0.0, curves.nodes[-1], 1.0 / rate)
    return np.append(times[curves.nodes[-1] - times > _SAME], curves.nodes[-1])


def find_excesses(
    kind: str,
    name: str,
    values: Array,
    bounds: Array,
    t: Array,
    unit: str,
    tolerance: float = _TOLERANCE,
    size: float | None = None,
) -> Iterator[Excess]:
    """The largest excess of values, shape (n,), beyond each bound, if more than a part of its size."""
    size = size or max(float(np.max(np.abs(bounds[np.isfinite(bounds)]), initial=0.0)), _LEAST_SIZE)
    for bound, over in ((bounds[0], bounds[0] - values), (bounds[1], values - bounds[1])):
        if math.isfinite(bound) and over.size:
            worst = int(np.argmax(over))
            ratio = float(over[worst]) / size
            if ratio > tolerance:
                yield Excess(kind, name, float(values[worst]), float(bound), float(t[worst]), ratio, unit)
