"""Steps of given lengths that differ, and an accuracy in place of their number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem._checks import check_finite, check_number
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.path import PathConstraint
from mbocp.problem.timeline.step_counts import Places, base_counts

_FINEST, _COARSEST = 1e-10, 0.1  # what flows are sure of; beyond, a motion is hardly one
_ROUND_OFF = 1e-9  # relative: durations that are the same
_WIDEST = 1e6  # ratio of the longest step and the shortest


def check_accuracy(value: Any) -> float | None:
    """Return the accuracy that is asked for, checked.

    Raises
    ------
    InvalidValue
    """
    if value is None:
        return None
    number = check_number("horizon.accuracy", value)
    if not _FINEST <= number <= _COARSEST:
        expected = f"a number from {_FINEST:g} to {_COARSEST:g}: rad and m of a step, and a share of the cost"
        raise InvalidValue("horizon.accuracy", number, expected)
    return number


def check_lengths(lengths: Any, num_steps: int, duration: float) -> Array | None:
    """Return lengths of steps [s], checked, shape (N,).

    Raises
    ------
    InvalidValue, ProblemError
        If they are not positive, or not those of the steps and of the duration.
    """
    if lengths is None:
        return None
    found = np.array(lengths, dtype=np.float64)
    if found.shape != (num_steps,):
        raise ProblemError(
            f"horizon.lengths: got shape {found.shape}, expected one number for each of {num_steps} steps"
        )
    check_finite("horizon.lengths", found)
    if found.min() <= 0.0 or found.max() > _WIDEST * found.min():
        worst = int(found.argmin())
        expected = f"a positive number [s], and at least {1 / _WIDEST:g} of the longest"
        raise InvalidValue(f"horizon.lengths[{worst}]", float(found[worst]), expected)
    total = float(found.sum())
    if abs(total - duration) > _ROUND_OFF * duration:
        raise ProblemError(
            f"horizon.lengths: they take {total:.12g} s in all, but horizon.duration is {duration:.12g} s; "
            "leave one of them out"
        )
    return frozen_array(found)


def scaled_lengths(lengths: Sequence[float] | Array, duration: float) -> Array:
    """Lengths of which the sum is a duration [s], to round-off."""
    found = np.array(lengths, dtype=np.float64)
    scaled: Array = found * (duration / found.sum())
    return scaled


def check_takes_steps(
    places: Places,
    accuracy: float | None,
    lengths: Array | None,
    coordinates: str,
    *,
    is_switched: bool,
    has_targets: bool,
) -> None:
    """Refuse what steps of different lengths, or steps that are found, do not go with.

    Parameters
    ----------
    places : Places
    accuracy, lengths, coordinates
        As in `mbocp.problem.Problem`.
    is_switched : bool
        Whether there are holds, releases or impacts.
    has_targets : bool
        Whether the cost has a target for each step.

    Raises
    ------
    ProblemError
    """
    if accuracy is None and lengths is None:
        return
    key = "horizon.accuracy" if accuracy is not None else "horizon.lengths"
    if accuracy is not None and lengths is not None:
        raise ProblemError(f"{key}: horizon.lengths gives the steps; leave one of them out")
    refused: list[tuple[object, str]] = [(has_targets, "a target for each step")]
    if accuracy is not None and is_switched and not places.phase:
        raise ProblemError(
            f"{key}: does not go with holds, releases and impacts that are given by numbers of steps; say "
            "them in phases, as in [[phase.hold]], whose steps are found, or give horizon.steps in its place"
        )
    if lengths is not None:
        constraints = [one for one in places.path if isinstance(one, PathConstraint)]
        spans = [constraint.span for constraint in constraints]
        spans += [term.span for term in places.terms if term.role == "path"]
        has_parts = any(span.since is not None or span.until is not None for span in spans)
        refused += [
            (is_switched, "constraints that begin or end along the way, whose steps phases give"),
            (
                not COORDINATES[coordinates].has_joint_states,
                f'coordinates = "{coordinates}", whose steps are as long as each other',
            ),
            (places.phase, "[[phase]], of which each has a number of steps"),
            (
                places.duration_range is not None,
                "a free horizon.duration, whose steps are as long as each other",
            ),
            (places.via, "[[via]], which are at nodes of equal steps"),
            (has_parts, "from and until of [[path]]"),
            (any(constraint.kind == "follow" for constraint in constraints), 'kind = "follow"'),
        ]
    for is_there, words in refused:
        if is_there:
            raise ProblemError(f"{key}: does not go with {words}; give horizon.steps in its place")
    if accuracy is not None:
        base_counts(places)
