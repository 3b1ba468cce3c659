"""Limits, and weights of the running cost, that differ from phase to phase.

The functions of a programme take the heaviest weights of all phases, and for each step the part of them that
counts in its phase. So the cost stays linear in parameters of the whole horizon, and functions depend on
which weights differ, not on their numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from itertools import pairwise

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError, reword_errors
from mbocp.problem.limits import LIMITS, Bounds
from mbocp.problem.rate_limits import check_rates
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.weights import Cost, weights_by_key
from mbocp.robot import Robot

_AT_NODES = ("q", "v")  # letters of `LIMITS`; others are of steps


def in_phase(name: str) -> AbstractContextManager[None]:
    """Name the phase in every error from the block."""
    return reword_errors(lambda words: words if words.startswith("phase ") else f"phase {name!r}: {words}")


def fit_phases(robot: Robot, phases: Sequence[Phase], limits: Bounds, cost: Cost) -> tuple[Phase, ...]:
    """Return phases with limits in the dimensions of the robot.

    Raises
    ------
    DimensionMismatch, InvalidValue, ProblemError
        If limits or weights do not fit the robot, or no state is within those of two neighbours.
    """
    found = []
    for phase in phases:
        with in_phase(phase.name):
            own = replace(phase, limits=phase.limits.complete(robot))
            check_rates(robot, own.limits)
            if own.limits.finite("rms").any():
                raise ProblemError(f"{LIMITS['rms']}: it is of the whole motion, and belongs into [limits]")
            weighed = cost.with_weights(own.weights).on_controls(robot.nu)
            weighed.check_controls(
                widest_limits(limits, [own]).finite("u"), [label.name for label in robot.u_labels]
            )
        found.append(own)
    for before, after in pairwise(zip(found, limits_of_phases(limits, found), strict=True)):
        _check_neighbours(robot, before, after)
    return tuple(found)


def _check_neighbours(robot: Robot, before: tuple[Phase, Bounds], after: tuple[Phase, Bounds]) -> None:
    (phase, one), (following, other) = before, after
    for letter, labels in (("q", robot.q_labels), ("v", robot.v_labels)):
        if following.leaps and letter == "v":
            continue
        lower, upper = zip(one.sides(letter), other.sides(letter), strict=True)
        low, high = np.maximum(*lower), np.minimum(*upper)
        for i in np.flatnonzero(low > high):
            raise ProblemError(
                f"phase {following.name!r}: {LIMITS[letter]}: no {labels[i].name} is within it and within "
                f"that of phase {phase.name!r}, as the state between them has to be; let them overlap"
            )


def have_limits(phases: Sequence[Phase]) -> bool:
    """Return whether any phase has limits of its own."""
    return any(phase.limits.any_finite for phase in phases)


def limits_of_phases(limits: Bounds, phases: Sequence[Phase]) -> list[Bounds]:
    """Return limits that hold in each phase: its own, and those of the problem where it has none."""
    if not have_limits(phases):
        return [limits] * len(phases)
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


def widest_limits(limits: Bounds, phases: Sequence[Phase]) -> Bounds:
    """Return bounds that are finite where any phase has one, as wide as the widest of these."""
    if not have_limits(phases):
        return limits
    each, sides = limits_of_phases(limits, phases), {}
    for letter in LIMITS:
        for side, infinity, widest in (("lower", -np.inf, np.min), ("upper", np.inf, np.max)):
            rows = np.array([getattr(bounds, f"{letter}_{side}") for bounds in each])
            kept = np.where(np.isfinite(rows), rows, -infinity)
            reduced = widest(kept, axis=0)
            sides[f"{letter}_{side}"] = np.where(np.isfinite(rows).any(axis=0), reduced, infinity)
    return Bounds(**sides)


def limits_along(limits: Bounds, phases: Sequence[Phase]) -> Mapping[str, tuple[Array, Array]]:
    """Return lower and upper bounds at the nodes 1..N, or in the N steps, by letters of `LIMITS`.

    A node between two phases belongs to both; velocities before an impact to the phase before it. Shapes are
    (N, n), or (1, n) where all phases have the same.
    """
    if not have_limits(phases):
        same = ((letter, limits.sides(letter)) for letter in LIMITS)
        return {letter: (lower[None], upper[None]) for letter, (lower, upper) in same}
    each, found = limits_of_phases(limits, phases), {}
    counts = [phase.last - phase.first for phase in phases]
    for letter in LIMITS:
        sides = [bounds.sides(letter) for bounds in each]
        lower = np.repeat([low for low, _ in sides], counts, axis=0)
        upper = np.repeat([high for _, high in sides], counts, axis=0)
        for phase, (low, high) in list(zip(phases, sides, strict=True))[1:] if letter in _AT_NODES else ():
            if not (phase.leaps and letter == "v"):
                lower[phase.first - 1] = np.maximum(lower[phase.first - 1], low)
                upper[phase.first - 1] = np.minimum(upper[phase.first - 1], high)
        found[letter] = (lower, upper)
    return found


def heaviest_cost(cost: Cost, phases: Sequence[Phase], robot: Robot) -> Cost:
    """Return the cost with those weights of all phases that are largest, component by component."""
    rows = _weights_of_phases(cost, phases, robot)
    return cost.with_weights({key: _shape(key, _heaviest(values)) for key, values in rows.items()})


def is_weighed(key: str, cost: Cost, phases: Sequence[Phase]) -> bool:
    """Whether a term of the cost has a weight in the whole motion, or one of its own in a phase."""
    return bool(np.any(cost.weight(key))) or any(key in phase.weights for phase in phases)


def weight_shares(cost: Cost, phases: Sequence[Phase], robot: Robot) -> dict[str, Array]:
    """Return which part of the heaviest weights counts in each step, shape (N, size), by the term's key."""
    found, counts = {}, [phase.last - phase.first for phase in phases]
    for key, values in _weights_of_phases(cost, phases, robot).items():
        heaviest = _heaviest(values)
        shares = np.divide(values, heaviest, out=np.ones_like(values), where=heaviest != 0.0)
        found[key] = np.repeat(shares, counts, axis=0)
    return found


def _weights_of_phases(cost: Cost, phases: Sequence[Phase], robot: Robot) -> dict[str, Array]:
    """Return weights in each phase, shape (phases, size), of those terms that a phase names."""
    known, found = weights_by_key(), {}
    for key in (key for key in known if any(key in phase.weights for phase in phases)):
        size = known[key].size_over(robot.nu, robot.nv)
        rows = [np.asarray(phase.weights.get(key, cost.weight(key)), dtype=float) for phase in phases]
        found[key] = np.array([np.broadcast_to(row, (size,)) for row in rows])
    return found


def _heaviest(rows: Array) -> Array:
    places = np.abs(rows).argmax(axis=0)
    return rows[places, np.arange(rows.shape[1])]


def _shape(key: str, weights: Array) -> Array | float:
    return float(weights[0]) if key == "potential" else weights
