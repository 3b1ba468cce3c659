"""Limits that differ from phase to phase."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import MbocpError, ProblemError
from mbocp.problem.cost import Cost
from mbocp.problem.limits import LIMITS, Bounds
from mbocp.problem.rates import check_rates
from mbocp.problem.timeline.named_phase import NamedPhase, phase_nodes
from mbocp.problem.timeline.phase_holds import begin_with_impacts
from mbocp.robot import Robot

_AT_NODES = ("q", "v")  # letters of `LIMITS`; others are of steps


@contextmanager
def in_phase(name: str) -> Iterator[None]:
    """Name the phase in every error from the block."""
    try:
        yield
    except MbocpError as error:
        words = str(error)
        error.args = (words if words.startswith("phase ") else f"phase {name!r}: {words}",)
        raise


def checked_phases(
    robot: Robot, phases: Sequence[NamedPhase], limits: Bounds, cost: Cost
) -> tuple[NamedPhase, ...]:
    """Phases with limits in the dimensions of the robot.

    Raises
    ------
    DimensionMismatch, InvalidValue, ProblemError
        If limits or weights do not fit the robot, or no state is within those of two neighbours.
    """
    found = []
    for phase in phases:
        with in_phase(phase.name):
            own = replace(phase, limits=phase.limits.completed(robot))
            check_rates(robot, own.limits)
            weighed = cost.with_weights(own.weights).on_controls(robot.nu)
            weighed.check_controls(
                widest_limits(limits, [own]).finite("u"), [label.name for label in robot.u_labels]
            )
        found.append(own)
    leaps = begin_with_impacts(found)[1:]
    pairs = pairwise(zip(found, limits_of_phases(limits, found), strict=True))
    for ((before, one), (after, other)), leap in zip(pairs, leaps, strict=True):
        _check_neighbours(robot, before.name, one, after.name, other, leaps=leap)
    return tuple(found)


def limits_of_phases(limits: Bounds, phases: Sequence[NamedPhase]) -> list[Bounds]:
    """Limits that hold in each phase: its own, and those of the problem where it has none."""
    found = []
    for phase in phases:
        sides = {}
        for letter in LIMITS:
            is_own = phase.limits.finite(letter)
            for side in ("lower", "upper"):
                name = f"{letter}_{side}"
                sides[name] = np.where(is_own, getattr(phase.limits, name), getattr(limits, name))
        found.append(Bounds(**sides))
    return found


def widest_limits(limits: Bounds, phases: Sequence[NamedPhase]) -> Bounds:
    """Bounds that are finite where any phase has one, as wide as the widest of these."""
    if not any(phase.limits.any_finite for phase in phases):
        return limits
    each, sides = limits_of_phases(limits, phases), {}
    for letter in LIMITS:
        for side, infinity, widest in (("lower", -np.inf, np.min), ("upper", np.inf, np.max)):
            rows = np.array([getattr(bounds, f"{letter}_{side}") for bounds in each])
            kept = np.where(np.isfinite(rows), rows, -infinity)
            reduced = widest(kept, axis=0)
            sides[f"{letter}_{side}"] = np.where(np.isfinite(rows).any(axis=0), reduced, infinity)
    return Bounds(**sides)


def limits_along(limits: Bounds, phases: Sequence[NamedPhase]) -> Mapping[str, tuple[Array, Array]]:
    """Lower and upper bounds at the nodes 1..N, or in the N steps, by letters of `LIMITS`.

    A node between two phases belongs to both; velocities before an impact to the phase before it. Shapes are
    (N, n), or (1, n) where all phases have the same.
    """
    if not any(phase.limits.any_finite for phase in phases):
        return {
            letter: (getattr(limits, f"{letter}_lower")[None], getattr(limits, f"{letter}_upper")[None])
            for letter in LIMITS
        }
    each, spans = limits_of_phases(limits, phases), list(phase_nodes(phases).values())
    leaps = begin_with_impacts(phases)
    found = {}
    for letter in LIMITS:
        sides = [(getattr(b, f"{letter}_lower"), getattr(b, f"{letter}_upper")) for b in each]
        lower = np.repeat([low for low, _ in sides], [last - first for first, last in spans], axis=0)
        upper = np.repeat([high for _, high in sides], [last - first for first, last in spans], axis=0)
        if letter in _AT_NODES:
            for (first, _), (low, high), leap in list(zip(spans, sides, leaps, strict=True))[1:]:
                if leap and letter == "v":
                    continue
                lower[first - 1] = np.maximum(lower[first - 1], low)
                upper[first - 1] = np.minimum(upper[first - 1], high)
        found[letter] = (lower, upper)
    return found


def _check_neighbours(
    robot: Robot, before: str, one: Bounds, after: str, other: Bounds, *, leaps: bool
) -> None:
    for letter, labels in (("q", robot.q_labels), ("v", robot.v_labels)):
        if leaps and letter == "v":
            continue
        low = np.maximum(getattr(one, f"{letter}_lower"), getattr(other, f"{letter}_lower"))
        high = np.minimum(getattr(one, f"{letter}_upper"), getattr(other, f"{letter}_upper"))
        for i in np.flatnonzero(low > high):
            raise ProblemError(
                f"phase {after!r}: {LIMITS[letter]}: no {labels[i].name} is within it and within that of "
                f"phase {before!r}, as the state between them has to be; let them overlap"
            )
