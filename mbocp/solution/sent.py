"""A motion as it is sent to a controller: sampled, joined again, and fitted into the limits of joints.

A motion within its limits at nodes, or all along its cubics, may leave them as it is sent: by quintics that
swing over, and by accelerations that leap, which no limit of jerk allows. Where it leads from rest to rest
it is fitted: jerks by a moving mean, see `mbocp.solution.curves`, of its cubics or of the spline through its
nodes; what is left by more time, which lowers all speeds, accelerations and jerks. Of all means that is taken
which makes the motion longer by least. The way stays. Where it begins or ends moving it is the nearest motion
that keeps the limits from its state, see `mbocp.solution.nearest`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp._dataclass import dataclass
from mbocp.exceptions import InvalidValue
from mbocp.solution.curves import AT_REST, Curves, differences
from mbocp.solution.nearest import Ends, Nearest
from mbocp.solution.problem_facts import BrakingPlace
from mbocp.solution.solution_data import SolutionData
from mbocp.terms.rates import RATE_TERMS

INTERPOLATIONS = ("cubic", "quintic")
_LARGEST_RATE = 1e5  # [1/s]
_MOST_SAMPLES = 2_000_000
_PARTS = 10  # of a step at whose ends limits are looked at
_TOLERANCE = 1e-4  # relative, of a limit that is exceeded between nodes
_FITTED = 1e-7  # relative, by which a motion that is fitted may leave a limit, as solvers may
MOST = 0.1  # of the duration, that a motion is made longer by to fit it
_PART = 0.05  # of the time that a jerk takes to the largest acceleration: the shortest mean
_LEAST_PART = 1e-3  # of the longest mean, that the shortest is
_WIDTHS = 24  # of means, each about 1.3 times as long as the one before
_LEAST_SIZE = 1e-9  # of a limit
_SAME = 1e-9  # [s]
_NEAREST = 0.1  # of the time between samples, that they are apart from nodes
_PLACES = 8  # of a moving mean of controls
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
        return self.kind in _OF_CONTROLS or (self.kind == "path" and self.unit not in ("m", "rad"))

    @property
    def words(self) -> str:
        """The excess without the name."""
        if self.kind == "path":
            over = abs(self.value - self.bound)
            return f"{self.value:.4g} {self.unit} at {self.time:.4g} s, {over:.2g} beyond {self.bound:.4g}"
        return (
            f"{self.kind} {self.value:.4g} {self.unit} at {self.time:.4g} s, "
            f"{100.0 * self.ratio:.1f} % beyond {self.bound:.4g}"
        )


class NotCheckedWarning(UserWarning):
    """Some limits or efforts of a motion cannot be looked at as it is sent."""


@dataclass(frozen=True, eq=False)
class Sent:
    """A motion as it is sent.

    Attributes
    ----------
    solution : Solution
    joints : tuple of str
        Those of one velocity; others (floating bases, balls) are not among them. Elastic ones are those of
        their motors, which go by the names of the joints in `names`.
    units : tuple of str
        Of their positions.
    curves : Curves
        Of these, from the start of the motion; continuous joints count their turns.
    times : ndarray
        Of the samples, from the start [s].
    mean : float
        Time of the moving mean [s]; 0 without.
    slower : float
        Factor of the duration, after the mean.
    excesses : tuple of Excess
        Limits that it leaves all the same, the worst by its ratio first.
    is_of_spline : bool
        Whether the moving mean is that of the spline through the nodes, not of the cubics.
    is_nearest : bool
        Whether it is the nearest motion within limits from the state at its start.
    lag : float
        Time by which positions follow the controls of the solution before all that [s].
    """

    solution: SolutionData
    joints: tuple[str, ...]
    units: tuple[str, ...]
    curves: Curves
    times: Array
    mean: float
    slower: float
    excesses: tuple[Excess, ...]
    is_of_spline: bool = False
    is_nearest: bool = False
    lag: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names that controllers know the joints by."""
        joints = {motor: joint for joint, motor in self.solution.facts.elastic.items()}
        return tuple(joints.get(name, name) for name in self.joints)

    @property
    def words(self) -> str:
        """How it was fitted; "" if it was not."""
        mean = f"moving mean over {1e3 * self.mean:.3g} ms" if self.mean else ""
        nearest = "nearest motion within limits" if self.is_nearest else ""
        slower = f"slower by {100.0 * (self.slower - 1.0):.2g} %" if self.slower > 1.0 else ""
        return ", ".join(word for word in (mean, nearest, slower) if word)

    def times_of(self, t: Array) -> Array:
        """When it is where the solution is at times t [s]; before its start, or after its end, for some."""
        return self.slower * (t - self.solution.t[0] + self.lag + self.mean / 2.0)

    def controls(self, times: Array) -> Array:
        """Controls of the solution at times of the sent motion [s], shape (k, nu): means where it is one."""
        nodes, middle = self.solution.t, self.solution.t[0] + times / self.slower - self.mean / 2.0
        before = nodes[np.maximum(np.searchsorted(nodes, middle + _SAME, side="right") - 1, 0)]
        middle = np.where(np.abs(before - middle) < _SAME, before, middle)  # times of nodes may be rounded
        offsets = self.mean * ((np.arange(_PLACES) + 0.5) / _PLACES - 0.5) if self.mean else [0.0]
        return np.mean([self.solution.controls_at(middle + offset) for offset in offsets], axis=0)


def motion_as_sent(
    solution: SolutionData,
    rate: float | None = None,
    interpolation: str | None = None,
    *,
    is_joined: bool = False,
    fit: bool = False,
    slower: float = 1.0,
    mean: float = 0.0,
    like: Sent | None = None,
) -> Sent:
    """Say what is sent of a motion.

    Parameters
    ----------
    solution : Solution
    rate : float, optional
        Samples a second [1/s]; the nodes by default. Where a controller joins them nodes are among them; else
        a motion that is fitted takes a whole number of them.
    interpolation : {"cubic", "quintic"}, optional
        Between the nodes. Default: cubics; where the controller joins samples quintics, or cubics where
        jerks are free and quintics leave limits that cubics keep.
    is_joined : bool
        Whether the controller puts the same polynomials between samples.
    fit : bool
        Whether the motion is fitted into the limits of its joints, made longer by up to a tenth. Without a
        rate only what is joined is, since nothing else says what is sent.
    slower : float
        Least factor of the duration of a motion that is fitted, as efforts may ask for it.
    mean : float
        Least time of its moving mean [s], as rates of efforts may ask for it: one over a step makes leaps of
        accelerations from step to step the slopes that the problem takes them for.
    like : Sent, optional
        A motion that is sent already, and that this one begins with, see `mbocp.solution.joined`. Its moving
        mean and the factor of its duration are taken, so that both are one where the solutions are.

    Raises
    ------
    InvalidValue
        If the rate cannot be right, or no joint has one velocity.
    """
    if interpolation not in (*INTERPOLATIONS, None):
        raise InvalidValue.of_choice("interpolation", str(interpolation), INTERPOLATIONS)
    joints, cubics, lag = _read(solution, is_joined=is_joined)
    _check_rate(rate, cubics)
    fitting = _Fitting(joints, cubics, rate, interpolation)
    found = _Fit(fitting.follow_request())
    can_fit = (rate is not None or is_joined) and not cubics.has_impacts
    if like is not None:
        found = fitting.like(like)
    elif fit and can_fit:
        found = fitting.fit(found, slower, mean)
    curves = found.curves
    excesses = sorted(joints.excesses(curves, rate), key=lambda excess: -excess.ratio)
    units = tuple(joints.unit("position", k) for k in range(len(joints.names)))
    times = _times(curves, rate)
    if is_joined:
        times = times[np.abs(times[:, None] - curves.nodes).min(axis=1) > _NEAREST / (rate or 1.0)]
        times = np.round(np.sort(np.append(times, curves.nodes)), 9)  # as messages have them [ns]
    fitted = (found.mean, found.slower, tuple(excesses), found.is_of_spline, found.is_nearest, lag)
    return Sent(solution, joints.names, units, curves, times, *fitted)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Curves, and what they were fitted by."""

    curves: Curves
    mean: float = 0.0
    slower: float = 1.0
    is_of_spline: bool = False
    is_nearest: bool = False


@dataclass(frozen=True, eq=False)
class _Joints:
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
                worst = max(worst, (1.0 + ratio) ** (1.0 / power) if ratio > _FITTED else 1.0)
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
            times = _times(curves, rate)
            speeds = curves.at(times)[1]
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
        return {
            "position": (positions, t),
            "speed": (velocities, t),
            "acceleration": (accelerations, at_accelerations),
            "jerk": (jerks, at_jerks),
        }


@dataclass(frozen=True, eq=False)
class _Fitting:
    """From the cubics of a solution to the curves that are sent."""

    joints: _Joints
    cubics: Curves
    rate: float | None
    interpolation: str | None

    @property
    def has_jerk(self) -> BoolArray:
        """Which joints have a limit of jerk."""
        lower, upper = self.joints.bounds.get("jerk", np.full((2, len(self.joints.names)), np.inf))
        return np.isfinite(lower) | np.isfinite(upper)

    def follow_request(self) -> Curves:
        """Curves that are not fitted."""
        if self.interpolation == "cubic" or not (self.interpolation or self.joints.is_joined):
            return self.cubics
        quintics = self.cubics.smooth(self.has_jerk)
        if self.interpolation or self.has_jerk.any():
            return quintics
        cubics, smooth = (self.joints.factor(curves, self.rate) for curves in (self.cubics, quintics))
        return self.cubics if cubics < smooth else quintics

    def like(self, other: Sent) -> _Fit:
        """As another motion was fitted."""
        base = self.cubics.spline() if other.is_of_spline else self.cubics
        if other.mean:
            base = base.mean(other.mean)
        elif other.curves.interpolation == "quintic":
            base = base.smooth(self.has_jerk)
        return _Fit(base.slow(other.slower), other.mean, other.slower, other.is_of_spline)

    def fit(self, asked: _Fit, slower: float, mean: float = 0.0) -> _Fit:
        """Curves that keep the limits, slower by a factor or more; as asked at worst."""
        has_no_means = self.joints.is_joined and self.interpolation == "cubic"
        if not self.joints.rest(self.cubics):
            return asked if has_no_means else self._nearest(asked, slower)
        found = asked
        if self.has_jerk.any() and self.joints.excesses(asked.curves, self.rate) and not has_no_means:
            found = self._smoother()
        if mean > found.mean and not has_no_means:
            found = _Fit(self.cubics.mean(mean), mean)
        curves, room = found.curves, _FITTED
        while slower * curves.nodes[-1] <= (1.0 + MOST) * self.cubics.nodes[-1]:
            slower = _whole(slower, curves.nodes[-1], None if self.joints.is_joined else self.rate)
            sent = curves.slow(slower)
            factor = self.joints.factor(sent, self.rate)
            if factor == 1.0:
                return replace(found, curves=sent, slower=slower)
            slower *= (1.0 + room) * factor
            room *= 2.0
        return asked

    def _nearest(self, asked: _Fit, slower: float) -> _Fit:
        """The nearest motion that keeps the limits from its state; as asked where that does, or none does."""
        joints, duration = self.joints, float(self.cubics.nodes[-1])
        rate = None if joints.is_joined else self.rate
        keeps = joints.factor(asked.curves, self.rate) == 1.0 and not joints.excesses(asked.curves, self.rate)
        is_limited = any(np.isfinite(joints.bounds.get(k, np.inf)).any() for k in ("acceleration", "jerk"))
        if not is_limited or (keeps and _whole(slower, duration, rate) == 1.0):
            return asked
        nearest = Nearest(self.cubics, joints.bounds, joints.braking, joints.ends)
        factor = nearest.least_factor(slower, 1.0 + MOST)
        curves = None if factor is None else nearest.slow(factor := _whole(factor, duration, rate))
        return asked if curves is None else _Fit(curves, slower=factor or 1.0, is_nearest=True)

    def _smoother(self) -> _Fit:
        """The moving mean of cubics or a spline that is shortest once it is slow enough."""
        sides = np.abs(self.joints.bounds["jerk"]).min(axis=0)
        largest = np.abs(self.cubics.places(1)[1][2]).max(axis=0)
        reach = np.divide(largest, sides, out=np.zeros_like(largest), where=sides > 0.0)  # [s]
        most = MOST * float(self.cubics.nodes[-1])
        least = float(np.clip(_PART * reach.max(), _LEAST_PART * most, 0.5 * most))
        found = []
        for base, is_of_spline in ((self.cubics, False), (self.cubics.spline(), True)):
            near, far = least, most
            for _ in range(2):  # coarsely, and about the best
                widths = np.geomspace(near, far, _WIDTHS)
                means = [base.mean(width) for width in widths]
                durations = [mean.nodes[-1] * self.joints.factor(mean, None) for mean in means]
                k = int(np.argmin(durations))
                fit = _Fit(means[k], float(widths[k]), is_of_spline=is_of_spline)
                found.append((durations[k], fit))
                near, far = widths[max(k - 1, 0)], widths[min(k + 1, _WIDTHS - 1)]
        return min(found, key=lambda one: one[0])[1]


def _read(solution: SolutionData, *, is_joined: bool) -> tuple[_Joints, Curves, float]:
    """Joints, cubics, and by how much these lag behind the nodes [s]."""
    columns = list(_columns(solution))
    if not columns:
        raise InvalidValue("solution", "no joint of one velocity", "joints that slide or turn about an axis")
    names, positions, at_v = (list(one) for one in zip(*columns, strict=True))
    places = {column.name: k for k, column in enumerate(solution.labels.q)}
    free = np.array([[-np.inf], [np.inf]])  # continuous joints
    of_q = [solution.limits_q[:, places[name], None] if name in places else free for name in names]
    bounds = {"position": np.hstack(of_q), "speed": solution.limits_v[:, at_v]}
    rates = [kind for kind in ("acceleration", "jerk") if kind in solution.facts.rates]
    bounds |= {kind: solution.facts.bounds_of_rate(kind)[:, at_v] for kind in rates}
    units = tuple(solution.labels.v[place].unit for place in at_v)
    curves = Curves(solution.t - solution.t[0], np.column_stack(positions), solution.vs[:, at_v])
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
    return _Joints(tuple(names), units, bounds, braking, ends, is_joined), curves, lag


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


def _check_rate(rate: float | None, curves: Curves) -> None:
    if rate is None:
        return
    if not (math.isfinite(rate) and 0.0 < rate <= _LARGEST_RATE):
        raise InvalidValue("rate", rate, f"samples a second, above 0 and up to {_LARGEST_RATE:g}")
    if curves.nodes[-1] * rate > _MOST_SAMPLES:
        words = f"at most {_MOST_SAMPLES} samples of a motion of {curves.nodes[-1]:g} s"
        raise InvalidValue("rate", rate, words)


def _times(curves: Curves, rate: float | None) -> Array:
    """Of samples, and of the end [s]."""
    if rate is None:
        return curves.nodes
    times = np.arange(0.0, curves.nodes[-1], 1.0 / rate)
    return np.append(times[curves.nodes[-1] - times > _SAME], curves.nodes[-1])


def _whole(slower: float, duration: float, rate: float | None) -> float:
    """The factor with which a duration [s] is a whole number of samples."""
    if rate is None:
        return slower
    return float(max(math.ceil((slower * duration - _SAME) * rate) / (rate * duration), 1.0))


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
