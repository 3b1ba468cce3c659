"""Phases of a motion that have a name: how long each takes, and what differs in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.exceptions import InvalidValue, ProblemError, suggest
from mbocp.problem._checks import check_integer
from mbocp.problem.cost import weights_by_key
from mbocp.problem.limits import Bounds
from mbocp.problem.timeline.duration import check_duration
from mbocp.problem.timeline.phase_holds import (
    PhaseHold,
    PhaseRelease,
    begin_with_impacts,
    end_with_partings,
    steps_of,
)
from mbocp.terms.span import Place

_ROUND_OFF = 1e-9  # relative: durations that are the same


@dataclass(frozen=True, kw_only=True, eq=False)
class NamedPhase:
    """A run of steps with a name.

    Attributes
    ----------
    name : str
        What it is called in messages, results, plots and overrides.
    steps : int
        Number of its steps that take time: an impact at its beginning is one more.
    duration : float
        [s]; a guess of it where `duration_range` says that it is free.
    duration_range : tuple of float, optional
        Least and greatest duration [s]; None: it is given.
    limits : Bounds
        In place of those of the problem, component by component where there is one.
    weights : mapping of str to ndarray
        Weights of terms of the running cost, by their key in `[cost]`, in place of those of the problem.
    holds : tuple of PhaseHold
        Frames that are held throughout.
    releases : tuple of PhaseRelease
        Constraints of the robot that do not hold.
    """

    name: str
    steps: int
    duration: float
    duration_range: tuple[float, float] | None = None
    limits: Bounds = field(default_factory=Bounds)
    weights: Mapping[str, Any] = field(default_factory=dict)
    holds: tuple[PhaseHold, ...] = ()
    releases: tuple[PhaseRelease, ...] = ()

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and self.name):
            raise InvalidValue("phase: name", self.name, "a word; every phase has one")
        key = f"phase {self.name!r}"
        object.__setattr__(self, "steps", check_integer(f"{key}: steps", self.steps, minimum=1))
        duration, bounds = check_duration(self.duration, self.duration_range, key=f"{key}: duration")
        object.__setattr__(self, "duration", duration)
        object.__setattr__(self, "duration_range", bounds)
        known = weights_by_key()
        for word in self.weights:
            if word not in known:
                raise ProblemError(
                    f"{key}: cost.{word}: differs in no phase, but a weight of these does: "
                    f"{suggest(word, dict.fromkeys(known), 40)}"
                )
        self._check_names("hold", [one.hold.name for one in self.holds])
        self._check_names("release", [one.constraint for one in self.releases])
        object.__setattr__(self, "weights", {k: frozen_array(w) for k, w in self.weights.items()})

    def _check_names(self, what: str, names: Sequence[str]) -> None:
        for name in names:
            if names.count(name) > 1:
                way = "; give each a name of its own" if what == "hold" else "; say it once"
                raise ProblemError(f"phase {self.name!r}: {what} {name!r}: there are several of it{way}")

    @property
    def is_free(self) -> bool:
        """Whether its duration is found with the motion."""
        return self.duration_range is not None

    @property
    def dt(self) -> float:
        """Length of its steps [s], or the guess of it."""
        return self.duration / self.steps


@dataclass(frozen=True)
class Horizon:
    """Number of steps and duration of the whole.

    Attributes
    ----------
    steps : int
        Impacts included.
    duration : float
        [s]; a guess where it is free.
    duration_range : tuple of float or None
        Bounds of a free one [s].
    """

    steps: int
    duration: float
    duration_range: tuple[float, float] | None


def horizon_of(phases: Sequence[NamedPhase]) -> Horizon:
    """What phases come to, one after the other."""
    duration = float(sum(phase.duration for phase in phases))
    bounds = None
    if any(phase.is_free for phase in phases):
        sides = [phase.duration_range or (phase.duration, phase.duration) for phase in phases]
        bounds = float(sum(low for low, _ in sides)), float(sum(high for _, high in sides))
    return Horizon(sum(step_counts(phases)), duration, bounds)


def with_total(phases: Sequence[NamedPhase], total: Horizon) -> tuple[tuple[float, ...], tuple[float, float]]:
    """Durations that come to that of the horizon, and bounds of the sum that those of phases do not imply.

    Returns
    -------
    durations : tuple of float
        Of the phases [s], or their guesses.
    bounds : tuple of float
        Least and greatest sum [s]; 0 and infinite where the phases say it.

    Raises
    ------
    ProblemError
        If names are not one for each, or the horizon contradicts its phases.
    """
    own, names = horizon_of(phases), [phase.name for phase in phases]
    for name in names:
        if names.count(name) > 1:
            raise ProblemError(f"phase {name!r}: there are several of this name; give each its own")
    if total.steps != own.steps:
        raise ProblemError(
            f"horizon.steps: got {total.steps}, but the phases have {own.steps} in all; leave it out, or "
            "change the steps of a phase"
        )
    low, high = own.duration_range or (own.duration, own.duration)
    least, most = total.duration_range or (total.duration, total.duration)
    room = _ROUND_OFF * high
    if least > high + room or most < low - room or (own.duration_range is None and least < most):
        asked = f"{least:g} s" if least == most else f"{least:g} to {most:g} s"
        has = f"{low:g} s" if low == high else f"{low:g} to {high:g} s"
        raise ProblemError(
            f"horizon.duration: got {asked}, but the phases take {has} in all; leave it out, or change the "
            "duration of a phase"
        )
    bounds = least if least > low + room else 0.0, most if most < high - room else np.inf
    return _spread(phases, total.duration), bounds


def _spread(phases: Sequence[NamedPhase], total: float) -> tuple[float, ...]:
    """Guesses moved towards their bounds, all by the same share of what there is, until they sum up."""
    guesses = np.array([phase.duration for phase in phases])
    missing = total - guesses.sum()
    if abs(missing) <= _ROUND_OFF * total:
        return tuple(float(guess) for guess in guesses)
    side = 1 if missing > 0.0 else 0
    ends = np.array([(p.duration_range or (p.duration, p.duration))[side] for p in phases])
    whole = (ends - guesses).sum()
    share = min(missing / whole, 1.0) if whole else 0.0
    return tuple(float(value) for value in guesses + share * (ends - guesses))


def step_counts(phases: Sequence[NamedPhase]) -> tuple[int, ...]:
    """Number of steps of each phase, with those of no duration at its beginning and at its end."""
    return steps_of(phases)


def phase_nodes(phases: Sequence[NamedPhase]) -> dict[str, tuple[int, int]]:
    """First and last node of each phase, by name; an impact at its beginning is part of it."""
    ends = list(accumulate(step_counts(phases), initial=0))
    return {phase.name: (ends[i], ends[i + 1]) for i, phase in enumerate(phases)}


def phase_spans(phases: Sequence[NamedPhase]) -> dict[str, Place]:
    """Node after the impact with which a phase begins, or else its first, and its last one, by name."""
    ends = zip(begin_with_impacts(phases), end_with_partings(phases), strict=True)
    pairs = zip(phase_nodes(phases).items(), ends, strict=True)
    return {name: Place(first + leap, last, int(parts)) for (name, (first, last)), (leap, parts) in pairs}


def places_by_name(via: Mapping[str, tuple[int, int]], phases: Mapping[str, Place]) -> dict[str, Place]:
    """Nodes of via points and phases by name.

    Raises
    ------
    ProblemError
        If one of each have the same name.
    """
    for name in via:
        if name in phases:
            raise ProblemError(f"via {name!r}: a phase has this name, too; give each its own")
    return {**{name: Place(*nodes) for name, nodes in via.items()}, **phases}


def are_alike(phases: Sequence[NamedPhase]) -> bool:
    """Whether all steps are as long as each other, and given."""
    lengths = np.array([phase.dt for phase in phases])
    is_free = any(phase.is_free for phase in phases)
    return not is_free and bool(np.ptp(lengths) <= _ROUND_OFF * lengths.mean()) if len(phases) else True


def phase_lengths(phases: Sequence[NamedPhase]) -> Array:
    """Lengths of the steps of all phases [s], shape (N,)."""
    return np.repeat([phase.dt for phase in phases], step_counts(phases))
