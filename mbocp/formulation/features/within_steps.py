r"""Limits of speeds, accelerations and jerks that hold within steps, too: part of what states remember.

In a step of length h from (q_0, v_0) to (q_1, v_1), with the mean m = (q_1 - q_0) / h, the speed of the cubic
through its nodes, see `mbocp.problem.step_cubics`, has the Bernstein coefficients

.. math:: v_0, \qquad b = 3m - v_0 - v_1, \qquad v_1,

and stays between the least and the largest of them. Nodes keep their limits: where b keeps them, too, the
whole step does. Its acceleration is linear and stays between those of both ends,

.. math:: a_0 = 2 (b - v_0) / h, \qquad a_1 = 2 (v_1 - b) / h.

The state after the step remembers b, or a_0 and a_1. Where controls are linear, the jerk (a_1 - a_0) / h may
have a limit, too; then a_0 of the first step is the acceleration at the start, and a_1 of the last one that
at the end, give or take what the jerk makes of them in a hundredth of a step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, IntArray, dataclass
from mbocp.formulation.features.feature import Feature, StepRequests, infinite_bounds
from mbocp.formulation.features.memory import memory_units
from mbocp.formulation.layout import Block
from mbocp.formulation.motion import Passage
from mbocp.problem import Problem
from mbocp.problem.between_nodes import widest_within
from mbocp.robot import Label
from mbocp.terms.rates import AT_END, PLACES, name_at

_WORDS = {
    "v": "speed within the step of",
    "a": "acceleration within the step of",
    "j": "jerk within the step of",
}
_SHARE = 0.01  # of a step, in which the limit of jerk leads to the acceleration at an end
_KEYS = {"v": "velocity", "a": "acceleration", "j": "jerk"}


@dataclass(frozen=True)
class WithinSteps(Feature):
    """Velocity components whose speed, acceleration or jerk has a limit within steps, by letter."""

    entries: tuple[tuple[str, tuple[int, ...]], ...]

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> WithinSteps | None:
        """Return those of a problem whose limits are to hold within steps."""
        entries = _entries(problem)
        return cls(entries) if entries else None

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """One entry for each, and place."""
        return tuple(
            Block(block_within(key), len(_places(key)) * len(own), has_unit=key != "v")
            for key, own in self.entries
        )

    def units(self, problem: Problem) -> Mapping[str, float]:
        """Of rates, the size of their limits: numbers that solvers see are of ordinary size."""
        return {name: unit for name, unit in units_within(problem).items() if name != block_within("v")}

    @property
    def state_key(self) -> Mapping[str, Any]:
        """Which they are."""
        return {block_within(key): list(own) for key, own in self.entries}

    def next_value(self, name: str, step: Passage) -> Any:
        """The coefficients b [m/s, rad/s], or a_0 and a_1 [m/s^2, rad/s^2], or the jerk in its unit."""
        b = 3.0 * step.way() / step.dt - step.s0 - step.s1
        key, own = next((key, list(own)) for key, own in self.entries if block_within(key) == name)
        if key == "v":
            values = [b]
        elif key == "a":
            pieces = b - step.s0, step.s1 - b
            values = [2.0 * piece / (step.dt * step.units[name]) for piece in pieces]
        else:
            values = [2.0 * (step.s0 + step.s1 - 2.0 * b) / step.dt**2 / step.units[name]]
        if isinstance(b, np.ndarray):
            return np.hstack([value[:, own] for value in values])
        return ca.vertcat(*[value[own] for value in values])

    def state_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Those of the limits; none in impacts, which take no time."""
        moves = np.flatnonzero(~problem.timeline.is_impact)
        found, units = {}, units_within(problem)
        for key, own in self.entries:
            places = len(_places(key))
            lower, upper = infinite_bounds(problem.num_steps, places * len(own))
            sides = widest_within(problem.limits_along()[key], moves)
            for side, limits in zip((lower, upper), sides, strict=True):
                side[moves] = np.tile(limits[:, own], places)
            if key == "a" and "j" in problem.limits_within:
                _begin_and_end(problem, list(own), moves, (lower, upper))
            name = block_within(key)
            found[name] = lower / units[name], upper / units[name]
        return found

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Of which velocity."""
        return [
            f"{_WORDS[key]} {speeds[i].name}" for key, own in self.entries for _ in _places(key) for i in own
        ]

    def state_words(self, problem: Problem) -> Mapping[str, str]:
        """What its limits are called."""
        return {block_within(key): f"{_KEYS[key]} limit within a step" for key, _ in self.entries}


def block_within(letter: str) -> str:
    """Return the name of the block of a limit, by its letter."""
    return f"{_KEYS[letter]}_within"


def units_within(problem: Problem) -> dict[str, float]:
    """Return units of the blocks of a problem, by name: of rates those of their limits."""
    units = {"velocity": 1.0, **memory_units(problem)}
    return {block_within(key): units[_KEYS[key]] for key, _ in _entries(problem)}


def names_within(problem: Problem) -> tuple[str, ...]:
    """Return names for the limits within steps of a problem, as of path constraints; none without any."""
    labels = problem.robot.v_labels
    return tuple(
        name_at(_KEYS[key], labels[i].name, place)
        for key, own in _entries(problem)
        for place in _places(key)
        for i in own
    )


def _places(letter: str) -> tuple[str, ...]:
    return tuple(place for place in PLACES[_KEYS[letter]] if place != AT_END)


def _begin_and_end(problem: Problem, own: list[int], moves: IntArray, sides: tuple[Array, Array]) -> None:
    """Narrow accelerations at the start, and at the end, to those that limits of jerks lead from and to."""
    begins, ends = problem.limits_of_ends
    count = len(own)
    for step, columns, at, bounds, asked in (
        (moves[0], slice(0, count), problem.a_start, begins, np.ones(problem.robot.nv, dtype=np.bool_)),
        (moves[-1], slice(count, 2 * count), problem.goal.a, ends, problem.goal.a_active),
    ):
        spare = _SHARE * problem.dt * np.minimum(-bounds.j_lower, bounds.j_upper)[own]
        spare = np.where(asked[own], spare, np.inf)
        low, high = (side[step, columns] for side in sides)
        low[:], high[:] = np.maximum(low, at[own] - spare), np.minimum(high, at[own] + spare)


def _entries(problem: Problem) -> tuple[tuple[str, tuple[int, ...]], ...]:
    limits = problem.widest_limits
    masks = {key: limits.finite(key) for key in problem.limits_within if key in _KEYS}
    if "j" in masks:  # which lead from one acceleration to another
        masks["a"] = masks.get("a", False) | masks["j"]
    return tuple((key, tuple(np.flatnonzero(mask).tolist())) for key, mask in sorted(masks.items()))
