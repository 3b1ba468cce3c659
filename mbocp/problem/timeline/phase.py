"""Phases: runs of steps that are as long as each other, and what differs in them.

A plain problem has one phase, without a name. `[[phase]]` has one for each of its tables, and free times of
via points divide the motion into phases whose lengths are found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import Any, Literal

from mbocp._arrays import dataclass, frozen_array
from mbocp.exceptions import InvalidValue, ProblemError, suggest
from mbocp.problem._checks import check_choice, check_integer
from mbocp.problem.limits import Bounds
from mbocp.problem.timeline.hold import Hold
from mbocp.problem.timeline.times import check_duration
from mbocp.problem.weights import weights_by_key
from mbocp.terms.span import NodePlace

Meeting = Literal["impact", "soft"]  # the key `meeting` of [[phase.hold]] and [[phase.release]]
MEETINGS = ("impact", "soft")


@dataclass(frozen=True)
class PhaseHold:
    """A frame is held throughout a phase.

    Attributes
    ----------
    hold : Hold
        What is held, without spans. The same in the phase before: it goes on.
    meeting : {"impact", "soft"}
        How it begins, after the first phase: velocities leap, inelastically, or they fit already.
    """

    hold: Hold
    meeting: Meeting = "impact"

    def __post_init__(self) -> None:
        check_choice(f"hold {self.hold.name!r}: meeting", self.meeting, MEETINGS)
        object.__setattr__(self, "hold", replace(self.hold, spans=()))


@dataclass(frozen=True)
class PhaseRelease:
    """A constraint of the robot does not hold throughout a phase.

    Attributes
    ----------
    constraint : str
    meeting : {"impact", "soft"}
        How it is taken on again, where a phase follows that does not release it.
    """

    constraint: str
    meeting: Meeting = "impact"

    def __post_init__(self) -> None:
        check_choice(f"release {self.constraint!r}: meeting", self.meeting, MEETINGS)


@dataclass(frozen=True, kw_only=True, eq=False)
class Phase:
    """A run of steps that are as long as each other.

    Attributes
    ----------
    steps : int
        Number of its steps that take time: impacts are more.
    duration : float
        [s]; a guess of it where `duration_range` says that it is free.
    duration_range : tuple of float, optional
        Least and greatest duration [s]; None: it is given.
    name : str
        What it is called in messages, results, plots and overrides; empty where no table says it.
    limits : Bounds
        In place of those of the problem, component by component where there is one.
    weights : mapping of str to ndarray
        Weights of terms of the running cost, by their key in `[cost]`, in place of those of the problem.
    holds : tuple of PhaseHold
        Frames that are held throughout.
    releases : tuple of PhaseRelease
        Constraints of the robot that do not hold.
    first, last : int
        Nodes where it begins and ends; 0 until the phases before it are known.
    leaps, parts : bool
        Whether it begins with an impact, and ends with a parting: steps of no duration, in which velocities
        become those that what is taken on, or all that was held, allows.
    """

    steps: int
    duration: float
    duration_range: tuple[float, float] | None = None
    name: str = ""
    limits: Bounds = field(default_factory=Bounds)
    weights: Mapping[str, Any] = field(default_factory=dict)
    holds: tuple[PhaseHold, ...] = ()
    releases: tuple[PhaseRelease, ...] = ()
    first: int = 0
    last: int = 0
    leaps: bool = False
    parts: bool = False

    @property
    def is_free(self) -> bool:
        """Whether its duration is found with the motion."""
        return self.duration_range is not None

    @property
    def sides(self) -> tuple[float, float]:
        """Least and greatest duration [s]."""
        return self.duration_range or (self.duration, self.duration)

    @property
    def dt(self) -> float:
        """Length of its steps [s], or the guess of it."""
        return self.duration / self.steps

    @property
    def place(self) -> NodePlace:
        """Node after the impact with which it begins, or else its first, and its last one."""
        return NodePlace(self.first + self.leaps, self.last, int(self.parts))


def check_phase(phase: Phase) -> Phase:
    """Return a phase that has a name with values in order, and weights as arrays.

    Raises
    ------
    InvalidValue, ProblemError
    """
    if not (isinstance(phase.name, str) and phase.name):
        raise InvalidValue("phase: name", phase.name, "a word; every phase has one")
    key = f"phase {phase.name!r}"
    steps = check_integer(f"{key}: steps", phase.steps, minimum=1)
    duration, bounds = check_duration(phase.duration, phase.duration_range, key=f"{key}: duration")
    known = weights_by_key()
    for word in phase.weights:
        if word not in known:
            raise ProblemError(
                f"{key}: cost.{word}: differs in no phase, but a weight of these does: "
                f"{suggest(word, dict.fromkeys(known), 40)}"
            )
    _check_once(f"{key}: hold", [one.hold.name for one in phase.holds], "give each a name of its own")
    _check_once(f"{key}: release", [one.constraint for one in phase.releases], "say it once")
    weights = {word: frozen_array(weight) for word, weight in phase.weights.items()}
    return replace(phase, steps=steps, duration=duration, duration_range=bounds, weights=weights)


def _check_once(key: str, names: Sequence[str], way: str) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ProblemError(f"{key} {name!r}: there are several of it; {way}")
