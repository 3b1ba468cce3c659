r"""Limits of speeds and accelerations that hold within steps, too: part of what states remember.

In a step of length h from (q_0, v_0) to (q_1, v_1), with the mean m = (q_1 - q_0) / h, the speed of the cubic
through its nodes, see `mbocp.problem.step_cubics`, has the Bernstein coefficients

.. math:: v_0, \qquad b = 3m - v_0 - v_1, \qquad v_1,

and stays between the least and the largest of them. Nodes keep their limits: where b keeps them, too, the
whole step does. Its acceleration is linear and stays between those of both ends,

.. math:: a_0 = 2 (b - v_0) / h, \qquad a_1 = 2 (v_1 - b) / h.

The state after the step remembers b, or a_0 and a_1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.features.feature import Asked, Feature, unbounded
from mbocp.formulation.features.passage import Passage
from mbocp.formulation.layout import Block
from mbocp.problem.between_nodes import widest_within
from mbocp.robot import Label
from mbocp.terms.rates import PLACES, name_at

if TYPE_CHECKING:
    from mbocp.problem import Problem

_WORDS = {"v": "speed within the step of", "a": "acceleration within the step of"}
_KEYS = {"v": "velocity", "a": "acceleration"}


@dataclass(frozen=True)
class WithinSteps(Feature):
    """Velocity components whose speed, and those whose acceleration has a limit within steps, by letter."""

    entries: tuple[tuple[str, tuple[int, ...]], ...]

    @classmethod
    def of(cls, problem: Problem, asked: Asked) -> WithinSteps | None:
        """Return those of a problem whose limits are to hold within steps."""
        return cls(_entries(problem)) if problem.limits_within else None

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """One entry for each, and place."""
        return tuple(Block(block_within(key), len(_places(key)) * len(own)) for key, own in self.entries)

    @property
    def state_key(self) -> Mapping[str, Any]:
        """Which they are."""
        return {block_within(key): list(own) for key, own in self.entries}

    def following(self, name: str, step: Passage) -> Any:
        """The coefficients b [m/s, rad/s], or a_0 and a_1 [m/s^2, rad/s^2]."""
        b = 3.0 * step.way() / step.dt - step.s0 - step.s1
        key, own = next((key, list(own)) for key, own in self.entries if block_within(key) == name)
        values = [b] if key == "v" else [2.0 * (b - step.s0) / step.dt, 2.0 * (step.s1 - b) / step.dt]
        if isinstance(b, np.ndarray):
            return np.hstack([value[:, own] for value in values])
        return ca.vertcat(*[value[own] for value in values])

    def state_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Those of the limits; none in impacts, which take no time."""
        moves = np.flatnonzero(~problem.timeline.is_impact)
        found = {}
        for key, own in self.entries:
            places = len(_places(key))
            lower, upper = unbounded(problem.num_steps, places * len(own))
            sides = widest_within(problem.limits_along()[key], moves)
            for side, limits in zip((lower, upper), sides, strict=True):
                side[moves] = np.tile(limits[:, own], places)
            found[block_within(key)] = (lower, upper)
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
    return PLACES[_KEYS[letter]]


def _entries(problem: Problem) -> tuple[tuple[str, tuple[int, ...]], ...]:
    limits = problem.widest_limits
    return tuple((key, tuple(np.flatnonzero(limits.finite(key)).tolist())) for key in problem.limits_within)
