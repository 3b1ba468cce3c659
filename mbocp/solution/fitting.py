"""From the cubics of a motion to curves that keep the limits of joints, made longer by least."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mbocp._arrays import BoolArray, dataclass
from mbocp.solution.curves import Curves
from mbocp.solution.joints_sent import FITTED, Joints
from mbocp.solution.nearest import Nearest

MOST = 0.1  # of the duration, that a motion is made longer by to fit it
_TRIES = 64  # of a duration
_PART = 0.05  # of the time that a jerk takes to the largest acceleration: the shortest mean
_LEAST_PART = 1e-3  # of the longest mean, that the shortest is
_WIDTHS = 24  # of means, each about 1.3 times as long as the one before
_LONG_MEAN = 5e-3  # of the duration: half of a mean is lost at rests, where accelerations leap half as far
_SAME = 1e-9  # [s]


@dataclass(frozen=True, eq=False)
class FitResult:
    """Curves, and what they were fitted by."""

    curves: Curves
    mean: float = 0.0
    slower: float = 1.0
    is_nearest: bool = False


@dataclass(frozen=True, eq=False)
class CurveFit:
    """From the cubics of a solution to the curves that are sent."""

    joints: Joints
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

    def fit(self, asked: FitResult, slower: float, mean: float = 0.0) -> FitResult:
        """Curves that keep the limits, slower by a factor or more; as asked at worst.

        From rest to rest the way stays, unless that takes more time than is allowed.
        """
        has_no_means = self.joints.is_joined and self.interpolation == "cubic"
        if not self.joints.rest(self.cubics):
            return asked if has_no_means else self._nearest(asked, slower)
        found = asked
        if self.has_jerk.any() and self.joints.excesses(asked.curves, self.rate) and not has_no_means:
            found = self._smoother()
        if mean > found.mean and not has_no_means:
            found = FitResult(self.cubics.mean(mean), mean)
        curves, factor, room = found.curves, slower, FITTED
        while factor * curves.nodes[-1] <= (1.0 + MOST) * self.cubics.nodes[-1]:
            factor = _whole(factor, curves.nodes[-1], None if self.joints.is_joined else self.rate)
            sent = curves.slow(factor)
            left = self.joints.factor(sent, self.rate)
            if left == 1.0:
                return replace(found, curves=sent, slower=factor)
            factor *= (1.0 + room) * left
            room *= 2.0
        return asked if has_no_means or mean else self._nearest(asked, slower)

    def _nearest(self, asked: FitResult, slower: float) -> FitResult:
        """The nearest motion that keeps the limits from its state; as asked where that does, or none does."""
        joints, duration = self.joints, float(self.cubics.nodes[-1])
        rate = None if joints.is_joined else self.rate
        keeps = joints.factor(asked.curves, self.rate) == 1.0 and not joints.excesses(asked.curves, self.rate)
        is_limited = any(np.isfinite(joints.bounds.get(k, np.inf)).any() for k in ("acceleration", "jerk"))
        if not is_limited or (keeps and _whole(slower, duration, rate) == 1.0):
            return asked
        return self._fastest(slower) or asked

    def shorten(self, found: FitResult, slower: float) -> FitResult:
        """The nearest motion, on a way beside, where that takes less time than a long mean; else the same."""
        if found.mean <= _LONG_MEAN * float(self.cubics.nodes[-1]):
            return found
        nearest = self._fastest(slower, float(found.curves.nodes[-1]))
        if nearest is None or self.joints.factor(nearest.curves, self.rate) > 1.0:
            return found
        return nearest

    def _fastest(self, slower: float, before: float = math.inf) -> FitResult | None:
        """The nearest motion in the least time, slower by a factor or more, that ends before a time [s]."""
        joints, duration = self.joints, float(self.cubics.nodes[-1])
        rate = None if joints.is_joined else self.rate
        nearest = Nearest(self.cubics, joints.bounds, joints.braking, joints.ends)
        factors = {_whole(factor, duration, rate) for factor in np.linspace(1.0, 1.0 + MOST, _TRIES + 1)}
        within = [factor for factor in factors if slower <= factor < (before - _SAME) / duration]
        found = nearest.fastest(sorted(within))
        return None if found is None else FitResult(found[1], slower=found[0], is_nearest=True)

    def _smoother(self) -> FitResult:
        """The moving mean of cubics or a spline that is shortest once it is slow enough.

        That over one step keeps limits of jerks as problems have them: of means of steps.
        """
        sides = np.abs(self.joints.bounds["jerk"]).min(axis=0)
        largest = np.abs(self.cubics.places(1)[1][2]).max(axis=0)
        reach = np.divide(largest, sides, out=np.zeros_like(largest), where=sides > 0.0)  # [s]
        most = MOST * float(self.cubics.nodes[-1])
        least = float(np.clip(_PART * reach.max(), _LEAST_PART * most, 0.5 * most))
        step, found = np.diff(self.cubics.nodes).max(keepdims=True), []
        for base in (self.cubics, self.cubics.spline()):
            near, far = least, most
            for _ in range(2):  # coarsely, and about the best
                widths = np.union1d(np.geomspace(near, far, _WIDTHS), step[(near < step) & (step < far)])
                means = [base.mean(width) for width in widths]
                durations = [mean.nodes[-1] * self.joints.factor(mean, None) for mean in means]
                k = int(np.argmin(durations))
                found.append((durations[k], FitResult(means[k], float(widths[k]))))
                near, far = widths[max(k - 1, 0)], widths[min(k + 1, len(widths) - 1)]
        return min(found, key=lambda one: one[0])[1]


def _whole(slower: float, duration: float, rate: float | None) -> float:
    """The factor with which a duration [s] is a whole number of samples."""
    if rate is None:
        return slower
    return float(max(math.ceil((slower * duration - _SAME) * rate) / (rate * duration), 1.0))
