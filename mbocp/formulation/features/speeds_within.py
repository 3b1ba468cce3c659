r"""Limits of speeds that hold within steps, too: part of what states remember.

In a step of length h from (q_0, v_0) to (q_1, v_1), with the mean m = (q_1 - q_0) / h, the speed of the cubic
through its nodes, see `mbocp.problem.step_cubics`, has the Bernstein coefficients

.. math:: v_0, \qquad b = 3m - v_0 - v_1, \qquad v_1,

and stays between the least and the largest of them. Nodes keep their limits: where b keeps them, too, the
whole step does. The state after the step remembers b.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.features.feature import Asked, Feature, unbounded
from mbocp.formulation.features.passage import Passage
from mbocp.formulation.layout import Block
from mbocp.problem.between_nodes import widest_within
from mbocp.robot import Label
from mbocp.terms.rates import name_within

if TYPE_CHECKING:
    from mbocp.problem import Problem

SPEEDS_WITHIN = "speeds_within"


@dataclass(frozen=True)
class SpeedsWithin(Feature):
    """Which velocity components have a limit."""

    entries: tuple[int, ...]

    @classmethod
    def of(cls, problem: Problem, asked: Asked) -> SpeedsWithin | None:
        """Return those of a problem whose limits are to hold within steps."""
        if not problem.has_limits_within:
            return None
        return cls(tuple(np.flatnonzero(problem.widest_limits.finite("v")).tolist()))

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """One entry for each."""
        return (Block(SPEEDS_WITHIN, len(self.entries)),)

    @property
    def state_key(self) -> Mapping[str, Any]:
        """Which they are."""
        return {SPEEDS_WITHIN: list(self.entries)}

    def following(self, name: str, step: Passage) -> Any:
        """The coefficient b [m/s, rad/s]."""
        found = 3.0 * step.way() / step.dt - step.s0 - step.s1
        entries = list(self.entries)
        return found[:, entries] if isinstance(found, np.ndarray) else found[entries]

    def state_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Those of the speeds; none in impacts, which take no time."""
        moves = np.flatnonzero(~problem.timeline.is_impact)
        lower, upper = unbounded(problem.num_steps, len(self.entries))
        sides = widest_within(problem.limits_along()["v"], moves)
        for side, own in zip((lower, upper), sides, strict=True):
            side[moves] = own[:, self.entries]
        return {SPEEDS_WITHIN: (lower, upper)}

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Of which velocity."""
        return [f"speed within the step of {speeds[i].name}" for i in self.entries]

    def state_words(self, problem: Problem) -> Mapping[str, str]:
        """What its limits are called."""
        return {SPEEDS_WITHIN: "velocity limit within a step"}


def names_within(problem: Problem) -> tuple[str, ...]:
    """Return names for the limits within steps of a problem, as of path constraints; none without any."""
    if not problem.has_limits_within:
        return ()
    labels = problem.robot.v_labels
    return tuple(name_within(labels[i].name) for i in np.flatnonzero(problem.widest_limits.finite("v")))
