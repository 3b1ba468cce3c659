"""A motion as it is sent to a controller: sampled, joined again, and fitted into the limits of joints.

A motion within its limits at nodes, or all along its cubics, may leave them as it is sent: by quintics that
swing over, and by accelerations that leap, which no limit of jerk allows. Where it leads from rest to rest
it is fitted: jerks by a moving mean, see `mbocp.solution.curves`, of its cubics or of the spline through its
nodes; what is left by more time, which lowers all speeds, accelerations and jerks. Of all means that is taken
which makes the motion longer by least. The way stays, unless joints alone have limits and the nearest motion
that keeps them is shorter than one with a long mean. Where it begins or ends moving it is that from its
state, see `mbocp.solution.nearest`.
"""

from __future__ import annotations

import math

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import InvalidValue
from mbocp.solution.curves import Curves
from mbocp.solution.fitting import CurveFit, FitResult
from mbocp.solution.joints_sent import Excess, read_joints, sample_times
from mbocp.solution.solution_data import SolutionData

INTERPOLATIONS = ("cubic", "quintic")
_LARGEST_RATE = 1e5  # [1/s]
_MOST_SAMPLES = 2_000_000
_SAME = 1e-9  # [s]
_NEAREST = 0.1  # of the time between samples, that they are apart from nodes
_PLACES = 8  # of a moving mean of controls


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
    is_nearest : bool
        Whether it is the nearest motion within limits from the state at its start.
    lag : float
        Time by which positions follow the controls of the solution before all that [s].
    rests : tuple of float
        Times of the motion before all that, on the way, at which one mean ends and the next begins [s].
    """

    solution: SolutionData
    joints: tuple[str, ...]
    units: tuple[str, ...]
    curves: Curves
    times: Array
    mean: float
    slower: float
    excesses: tuple[Excess, ...]
    is_nearest: bool = False
    lag: float = 0.0
    rests: tuple[float, ...] = ()

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

    def count_beside(self, rate: float) -> int:
        """Count samples before the last that no multiple of 1/`rate` [s] is at, but a node of the curves."""
        places = rate * self.times[:-1]
        return int((np.abs(places - np.round(places)) > rate * _SAME).sum())

    def times_of(self, t: Array) -> Array:
        """When it is where the solution is at times t [s]; before its start, or after its end, for some."""
        since = t - self.solution.t[0] + self.lag
        before, after = (np.searchsorted(self.rests, since + sign * _SAME) for sign in (-1, 1))
        return self.slower * (since + self.mean * (1.0 + before + after) / 2.0)

    def controls(self, times: Array) -> Array:
        """Controls of the solution at times of the sent motion [s], shape (k, nu): means where it is one."""
        nodes, since = self.solution.t, times / self.slower
        ends = self.mean * np.arange(1, len(self.rests) + 1) + self.rests
        middle = nodes[0] + since - self.mean * (np.searchsorted(ends, since) + 0.5)
        before = nodes[np.maximum(np.searchsorted(nodes, middle + _SAME, side="right") - 1, 0)]
        middle = np.where(np.abs(before - middle) < _SAME, before, middle)  # times of nodes may be rounded
        offsets = self.mean * ((np.arange(_PLACES) + 0.5) / _PLACES - 0.5) if self.mean else [0.0]
        return np.mean([self.solution.controls_at(middle + offset) for offset in offsets], axis=0)


def compute_motion_sent(
    solution: SolutionData,
    rate: float | None = None,
    interpolation: str | None = None,
    *,
    is_joined: bool = False,
    fit: bool = False,
    slower: float = 1.0,
    mean: float = 0.0,
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

    Raises
    ------
    InvalidValue
        If the rate cannot be right, or no joint has one velocity.
    """
    if interpolation not in (*INTERPOLATIONS, None):
        raise InvalidValue.of_choice("interpolation", str(interpolation), INTERPOLATIONS)
    joints, cubics, lag = read_joints(solution, is_joined=is_joined)
    _check_rate(rate, cubics)
    fitting = CurveFit(joints, cubics, rate, interpolation)
    found = FitResult(fitting.follow_request())
    can_fit = (rate is not None or is_joined) and not cubics.has_impacts
    if fit and can_fit:
        found = fitting.fit(found, slower, mean)
        if not mean and _has_limits_of_joints_alone(solution):
            found = fitting.shorten(found, slower)
    curves = found.curves
    excesses = sorted(joints.excesses(curves, rate), key=lambda excess: -excess.ratio)
    units = tuple(joints.unit("position", k) for k in range(len(joints.names)))
    times = sample_times(curves, rate)
    if is_joined:
        times = times[np.abs(times[:, None] - curves.nodes).min(axis=1) > _NEAREST / (rate or 1.0)]
        times = np.unique(np.round(np.append(times, curves.nodes), 9))  # as messages have them [ns], once
    rests = tuple(cubics.nodes[cubics.rests].tolist()) if found.mean else ()
    fitted = (found.mean, found.slower, tuple(excesses), found.is_nearest, lag, rests)
    return Sent(solution, joints.names, units, curves, times, *fitted)


def _has_limits_of_joints_alone(solution: SolutionData) -> bool:
    """Whether a way beside that of the solution is as good: nothing is on it, and no force has a limit."""
    facts = solution.facts
    of_joints = sum(math.isfinite(side) for one in facts.braking for side in (one.lower, one.upper))
    has_others = facts.via or facts.phases or facts.elastic or facts.limits_more_of_controls
    is_bound = has_others or facts.ties != 0 or len(facts.path) != of_joints
    return not (is_bound or np.isfinite(solution.limits_u).any())


def _check_rate(rate: float | None, curves: Curves) -> None:
    if rate is None:
        return
    if not (math.isfinite(rate) and 0.0 < rate <= _LARGEST_RATE):
        raise InvalidValue("rate", rate, f"samples a second, above 0 and up to {_LARGEST_RATE:g}")
    if curves.nodes[-1] * rate > _MOST_SAMPLES:
        words = f"at most {_MOST_SAMPLES} samples of a motion of {curves.nodes[-1]:g} s"
        raise InvalidValue("rate", rate, words)
