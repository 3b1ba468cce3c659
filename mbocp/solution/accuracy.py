"""What is known of a motion's errors; `mbocp.accuracy` finds them out."""

from __future__ import annotations

import math

from mbocp._arrays import dataclass

_SMALL = 0.02  # of a joint's way: the sum of its local errors


@dataclass(frozen=True)
class Accuracy:
    """Errors of a motion; NaN where nobody knows.

    Attributes
    ----------
    local_error : float
        Largest error of a configuration after one step [rad, m].
    local_joint : str
        Name of the velocity component along which it is, and
    local_time : float
        at the end of which step [s].
    sum_of_errors : float
        Local errors of all steps, added up, of the component where this is most of its way [rad, m].
    way : float
        Way of that component [rad, m].
    way_joint : str
        Its name.
    replay_error : float
        Error of the configuration at the end when the controls act on the robot in an open loop [rad, m], to
        two digits; infinite where errors grow too fast for that.
    replay_joint : str
    tracked_error : float
        The same where the controls answer deviations with the gains of the optimum, see `Solution.gains`.
    tracked_joint : str
    made_energy : float
        Energy that the steps make (positive) or lose, the largest sum up to a node [J].
    energy_range : float
        Difference of the greatest and the least energy along the motion, or the greatest kinetic energy if
        that is more [J].
    own_error : float
        What the local errors are wrong by, as far as it can tell [rad, m].
    asked : float
        What `horizon.accuracy` asked for; NaN where the number of steps was given.
    cost_error : float
        Error of the cost against that of steps of no length, as a share of it: an estimate of the rounds in
        which the steps were found. Zero where the cost is.
    rounds : int
        Number of these.
    """

    local_error: float = math.nan
    local_joint: str = ""
    local_time: float = math.nan
    sum_of_errors: float = math.nan
    way: float = math.nan
    way_joint: str = ""
    replay_error: float = math.nan
    replay_joint: str = ""
    tracked_error: float = math.nan
    tracked_joint: str = ""
    made_energy: float = math.nan
    energy_range: float = math.nan
    own_error: float = math.nan
    asked: float = math.nan
    cost_error: float = math.nan
    rounds: int = 0

    @property
    def is_known(self) -> bool:
        """Whether a flow was found that is better than the motion."""
        return math.isfinite(self.local_error)

    @property
    def share(self) -> float:
        """Sum of the local errors over the way."""
        return self.sum_of_errors / self.way if self.way > 0.0 else math.nan

    @property
    def is_small(self) -> bool:
        """Whether the local errors are small against the motion, as far as anything is known."""
        return not self.share > _SMALL
