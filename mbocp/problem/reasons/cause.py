"""One reason why a problem cannot be solved."""

from __future__ import annotations

from mbocp._arrays import dataclass


@dataclass(frozen=True)
class Cause:
    """Why there is no solution.

    Parameters
    ----------
    kind : str
        "speed", "acceleration", "jerk", "torque", "weight", "frame_speed", "fall", "momentum", "steps" or
        "damping"; "reach", "via", "goal" or "contradiction" of path constraints and obstacles.
    where : str
        Joint, control, path constraint, frame or via point.
    words : str
        One line for a person.
    is_certain : bool
        Whether it is a proof; else an estimate.
    excess : float
        How many times more is asked than there is.
    """

    kind: str
    where: str
    words: str
    is_certain: bool
    excess: float
