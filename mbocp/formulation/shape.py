"""The shape of a problem: all that decides the stage functions, and nothing that is only a number.

Two problems of the same shape share their compiled functions; start, goal, weights, target, bounds and step
length are parameters.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass

from mbocp.integrators import EXPLICIT_SCHEMES

__all__ = ["PathShape", "Shape"]

_OF_THE_END = ("penalise_q", "penalise_rate", "rate", "ng_q", "ng_rate", "guarded", "penalised_parts")
_OF_STAGES = (
    "lie",
    "substeps",
    "tracked_parts",
    "track_q",
    "track_p",
    "weigh_velocity",
    "weigh_potential",
    "path",
)


@dataclass(frozen=True)
class PathShape:
    """What the function of a path constraint depends on, see `mbocp.problem.PathConstraint`."""

    kind: str
    frame: int
    other: int | None
    axes: tuple[int, ...]


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
    weigh_velocity, weigh_potential, weigh_rate : bool
        Whether the running cost weighs velocities, potential energy, the rate of the controls.
    penalise_q, penalise_rate : bool
        Whether the terminal cost has a configuration and a rate part.
    rate : str
        "v" or "p": what the end condition and the terminal cost speak of beside q.
    ng_q, ng_rate : int
        Number of exact end conditions on configuration and rate.
    rotations, lie, substeps : str, str, int
        How an explicit scheme treats attitudes, and how many steps it takes in one.
    is_flat : bool
        See `StateLayout`.
    path : tuple of PathShape
    guarded : tuple of int
        Parts of the configuration space, by index, whose end condition is guarded.
    tracked_parts, penalised_parts : tuple of int or None
        Parts that the running and the terminal cost compare with their target; None: all.
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
    weigh_potential: bool = False
    weigh_rate: bool = False
    rotations: str = "quaternion"
    lie: str = ""
    substeps: int = 1
    is_flat: bool = False
    path: tuple[PathShape, ...] = ()
    guarded: tuple[int, ...] = ()
    tracked_parts: tuple[int, ...] | None = None
    penalised_parts: tuple[int, ...] | None = None

    @property
    def is_explicit(self) -> bool:
        """Whether a step gives the next state without solving for it."""
        return self.scheme in EXPLICIT_SCHEMES

    @property
    def is_natural(self) -> bool:
        """Whether a state is in natural coordinates."""
        return self.coordinates == "natural"

    @property
    def stage_text(self) -> str:
        """Canonical text of what the functions of a stage depend on, the material of their cache key."""
        return self._text(_OF_THE_END)

    @property
    def end_text(self) -> str:
        """Canonical text of what the functions of the end depend on."""
        return self._text(_OF_STAGES, scheme="explicit" if self.is_explicit else "implicit")

    def _text(self, without: tuple[str, ...], **instead: str) -> str:
        kept = {k: v for k, v in dataclasses.asdict(self).items() if k not in without}
        return json.dumps({**kept, **instead}, sort_keys=True)
