"""The time of a step: of the state where obstacles move by it, a parameter where the cost asks for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.features.feature import Feature, StepRequests
from mbocp.formulation.layout import Block
from mbocp.formulation.motion import Motion
from mbocp.formulation.steps import StepSymbols
from mbocp.robot import Label

if TYPE_CHECKING:
    from mbocp.problem import Problem
    from mbocp.problem.timeline.timeline import Timeline

CLOCK = "time"  # [s]
STEP_SHARE = "step_share"  # the parameter 1/N, where lengths of steps are found


@dataclass(frozen=True)
class Clock(Feature):
    """Path constraints see states alone, so these hold the time; free lengths have a clock of their own."""

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> Clock | None:
        """Return it where something moves by the time."""
        return cls() if asked.has_movers and not problem.timeline.has_free_lengths else None

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """The time."""
        return (Block(CLOCK, 1, is_remembered=False),)

    @property
    def state_key(self) -> Mapping[str, Any]:
        """That it is there."""
        return {"tells_time": True}

    def own_rows(self, at: StepSymbols) -> Sequence[ca.SX]:
        """The time before, and the length of the step."""
        place = at.space.layout.states[CLOCK]
        return [at.at0[place] + (1 - at.is_impact) * at.dt - at.at1[place]]

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """What it says."""
        return ("time",)

    def states_of(self, problem: Problem, motion: Motion) -> Mapping[str, Array]:
        """Times of the nodes."""
        lengths = np.where(problem.timeline.is_impact, 0.0, motion.dts)
        return {CLOCK: np.append(0.0, np.cumsum(lengths))[:, None]}


TIME = "t"  # [s]


@dataclass(frozen=True)
class Moment(Feature):
    """Time of a share `tau` of each step; states that have a clock tell the time themselves."""

    tau: float

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> Moment | None:
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
