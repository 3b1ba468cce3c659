"""The time at which a step is evaluated, a parameter of each step: where the cost asks for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.features.feature import Asked, Feature
from mbocp.formulation.steps import StepSymbols

if TYPE_CHECKING:
    from mbocp.problem import Problem
    from mbocp.problem.timeline.timeline import Timeline

TIME = "t"  # [s]


@dataclass(frozen=True)
class Moment(Feature):
    """Time of a share `tau` of each step; states that have a clock tell the time themselves."""

    tau: float

    @classmethod
    def of(cls, problem: Problem, asked: Asked) -> Moment | None:
        """Return it where a term looks at the time, and states have no clock."""
        return cls(asked.tau) if asked.uses_time and not problem.timeline.has_free_times else None

    @property
    def stage_parameters(self) -> Mapping[str, int]:
        """The time."""
        return {TIME: 1}

    def enter(self, at: StepSymbols) -> StepSymbols:
        """Take the time as it is given."""
        return replace(at, moment=at.given[TIME])

    def stage_numbers(self, problem: Problem) -> Mapping[str, Array]:
        """Times of the steps, or the guess of them."""
        return {TIME: _times(problem.timeline, self.tau)[:, None]}


def _times(timeline: Timeline, tau: float) -> Array:
    """Times in the steps at a share of each [s], or the guess of them, shape (N,)."""
    if timeline.has_unequal_lengths:
        return timeline.times()[:-1] + tau * timeline.lengths()
    goes = (~timeline.is_impact).astype(np.float64)
    return timeline.dt * (np.cumsum(goes) - goes + tau * goes)
