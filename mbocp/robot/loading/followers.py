"""Joints that follow others."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Follower:
    """A mimic joint: its displacement is ``multiplier * leader's + offset``.

    Attributes
    ----------
    name, leader : str
        Joints; the leader follows no other one.
    multiplier, offset : float
        Of the leader's displacement [rad/rad, m/rad, ...], and [rad, m].
    lower, upper, velocity : float
        Its own limits [rad, m; rad/s, m/s], infinite where there are none.
    damping, friction : float
        Its own [N m s/rad, N s/m; N m, N].
    """

    name: str
    leader: str
    multiplier: float
    offset: float
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    damping: float = 0.0
    friction: float = 0.0

    @property
    def leader_range(self) -> tuple[float, float]:
        """Displacements of the leader between which the follower is within its limits [rad, m]."""
        if self.multiplier == 0.0:
            return -math.inf, math.inf
        ends = [(end - self.offset) / self.multiplier for end in (self.lower, self.upper)]
        return min(ends), max(ends)

    @property
    def leader_velocity(self) -> float:
        """Speed of the leader at which the follower has its greatest [rad/s, m/s]."""
        return self.velocity / abs(self.multiplier) if self.multiplier else math.inf
