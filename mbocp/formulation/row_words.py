"""Words for the rows of a programme, for messages."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import cached_property

import numpy as np

from mbocp._arrays import dataclass, largest_entry
from mbocp.formulation.end_rows import acceleration_rows
from mbocp.formulation.features.feature import join
from mbocp.formulation.features.moved_start import start_ends
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.pieces import Pieces, RowLabels
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import Space
from mbocp.mechanics.held_frames import label_held
from mbocp.problem import Problem
from mbocp.programme import StateBounds
from mbocp.terms.periodic_end import PeriodicEnd


@dataclass(frozen=True)
class _RowWords:
    """(stage, row) -> words, see `StagewiseProgramme.describe_row`; it can be sent to another process."""

    at: StateLayout
    labels: RowLabels
    num_steps: int
    dt: float | None  # free lengths have no times before they are found
    duration: float | None
    of_end: tuple[str, ...]
    bounds: StateBounds
    limits: tuple[str, ...]
    blocks: tuple[str, ...]

    def __call__(self, stage: int, row: int) -> str:
        at, labels = self.at, self.labels
        of_stages = len(labels.of_stages)
        ny = of_stages + len(labels.constraints)
        if stage < 0:
            at_end = "at the end" if self.duration is None else f"at t = {self.duration:g} s"
            if row >= len(self.of_end):
                return f"guard of the end condition {at_end}"
            return f"end condition {row + 1} ({self.of_end[row]}) {at_end}"
        when = f"in step {stage + 1} of {self.num_steps}"
        if self.dt is not None:
            when = f"in the step to t = {(stage + 1) * self.dt:g} s"
        if row >= at.ndx + ny:
            entry = np.flatnonzero(self.bounds.has_limit[stage])[row - at.ndx - ny]
            return f"{self.limits[entry]} {when}"
        if row < at.nw:
            name = labels.positions[row].name if at.nw == at.nv else f"coordinate {row + 1}"
            return f"kinematics of {name} {when}"
        if row < at.nw + at.ns:
            return f"{labels.balance} of {labels.speeds[row - at.nw].name} {when}"
        if row < at.ndx:
            return f"{self.blocks[row - at.nw - at.ns]} {when}"
        if row < at.ndx + of_stages:
            return f"{labels.of_stages[row - at.ndx]} {when}"
        return f"constraint {labels.constraints[row - at.ndx - of_stages].name} {when}"


@dataclass(frozen=True, eq=False)
class RowDescriber:
    """The same, made when a row is asked for: few solves do.

    Attributes
    ----------
    pieces : Pieces
        Of the programme.
    bounds : StateBounds
    """

    pieces: Pieces
    bounds: StateBounds

    @cached_property
    def words(self) -> _RowWords:
        """What can be sent to another process."""
        return _row_words(self.pieces, self.bounds)

    def __call__(self, stage: int, row: int) -> str:
        """Say what a row is."""
        return self.words(stage, row)

    def __reduce__(self) -> tuple[Callable[[_RowWords], _RowWords], tuple[_RowWords]]:
        return copy, (self.words,)


def _row_words(pieces: Pieces, bounds: StateBounds) -> _RowWords:
    problem, features, labels = pieces.problem, pieces.signature.features, pieces.labels
    robot, of_end = problem.robot, tuple(pieces.end_rows.words(problem.robot, problem.goal))
    for term in problem.terms:
        of_end += (term.name,) * (term.trace(robot).rows if term.role == "end" else 0)
    for row in acceleration_rows(problem) if problem.sets_acceleration.any() else ():
        of_end += (f"acceleration of {robot.v_labels[largest_entry(row)].name}",)
    of_end += _start_words(problem, pieces.space)
    is_free = bool(problem.timeline.num_lengths or problem.timeline.impacts)
    return _RowWords(
        pieces.layout,
        labels,
        problem.num_steps,
        None if is_free else problem.dt,
        problem.duration if problem.duration_range is None else None,
        of_end,
        bounds,
        limits=tuple(_limits(pieces)),
        blocks=tuple(word for f in features for word in f.row_words(problem, labels.speeds)),
    )


def _start_words(problem: Problem, space: Space) -> tuple[str, ...]:
    """What the rows of a periodic motion, and of constraints at a free start, are."""
    names, found = problem.robot.v_labels, list[str]()
    for term in start_ends(problem, space) if isinstance(space, ConfigurationSpace) else ():
        if isinstance(term, PeriodicEnd):
            for prefix, D in (("cycle of ", term.D_q), ("cycle of the rate of ", term.D_v)):
                found += [prefix + names[largest_entry(row)].name for row in D]
            continue
        own, held = problem.robot.constraint_labels, label_held(term.held)
        for prefix, kept in (("", term.places), ("rate of ", term.rates)):
            labels = [*(own[i] for i in kept.own), *(held[i] for i in kept.held)]
            found += [f"{prefix}constraint {label.name} at the start" for label in labels]
    return tuple(found)


def _limits(pieces: Pieces) -> list[str]:
    """What limits of the entries of a state, of the controls and of the path functions are called."""
    problem, features, words = pieces.problem, pieces.signature.features, _state_limits(pieces)
    path = [f"path constraint {label.name!r}" for constraint in problem.path for label in constraint.labels]
    path += [f"limit of {label.name}" for limit in problem.limits_of_rates for label in limit.labels]
    of_controls = [word for feature in features for word in feature.control_words(problem)]
    return [*(words.get(i, f"limit of state {i + 1}") for i in range(pieces.layout.nx)), *of_controls, *path]


def _state_limits(pieces: Pieces) -> dict[int, str]:
    """Names of those of a state's entries that have one, by their places."""
    problem, at, speeds = pieces.problem, pieces.layout, pieces.labels.speeds
    names = {at.s.start + i: f"velocity limit of {speeds[i].name}" for i in range(at.ns)}
    for part in pieces.space.parts:
        for i in range(min(part.at_q.stop - part.at_q.start, part.at_z.stop - part.at_z.start)):
            label = problem.robot.q_labels[part.at_q.start + i]
            names[part.at_z.start + i] = f"position limit of {label.name}"
    words = join(feature.state_words(problem) for feature in pieces.signature.features)
    for name in words.keys() & at.states.keys():
        where = at.states[name]
        names |= dict.fromkeys(range(where.start, where.stop), words[name])
    return names
