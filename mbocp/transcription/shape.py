"""The shape of a problem: all that decides the stage functions, and nothing that is only a number.

Two problems of the same shape share their compiled functions; start, goal, weights, target and step length
are parameters.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass

__all__ = ["Shape"]


@dataclass(frozen=True)
class Shape:
    """What the stage functions depend on.

    Attributes
    ----------
    robot : str
        Fingerprint of the robot's equations.
    coordinates, scheme : str
        Choice of coordinates and integrator.
    track_q, track_p : bool
        Whether the running cost tracks configuration and momentum.
    weigh_velocity : bool
        Whether the running cost weighs velocities.
    penalise_q, penalise_rate : bool
        Whether the terminal cost has a configuration and a rate part.
    rate : str
        "v" or "p": what the end condition and the terminal cost speak of beside q.
    ng_q, ng_rate : int
        Number of exact end conditions on configuration and rate.
    """

    robot: str
    coordinates: str
    scheme: str
    track_q: bool
    track_p: bool
    weigh_velocity: bool
    penalise_q: bool
    penalise_rate: bool
    rate: str
    ng_q: int
    ng_rate: int

    @property
    def text(self) -> str:
        """Canonical text, the material of the cache key."""
        return json.dumps(dataclasses.asdict(self), sort_keys=True)
