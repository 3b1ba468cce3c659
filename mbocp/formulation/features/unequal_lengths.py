"""Given lengths of steps that differ: parameters of each step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from mbocp._arrays import Array
from mbocp.formulation.features.feature import Asked, Feature
from mbocp.formulation.features.switches import filled_lengths
from mbocp.formulation.steps import StepSymbols
from mbocp.mechanics.rates import spacings
from mbocp.problem import Problem

_STRETCH, _SPACING = "stretch", "spacing"  # length, and way between middles, by the mean length


@dataclass(frozen=True)
class UnequalLengths(Feature):
    """Each step takes its own length, so that states hold none."""

    @classmethod
    def of(cls, problem: Problem, asked: Asked) -> UnequalLengths | None:
        """Return it where a problem says so."""
        return cls() if problem.timeline.has_unequal_lengths else None

    @property
    def stage_parameters(self) -> Mapping[str, int]:
        """Length, and time from the middle of the step before."""
        return {_STRETCH: 1, _SPACING: 1}

    @property
    def stage_key(self) -> Mapping[str, Any]:
        """That there are such parameters."""
        return {"has_unequal_lengths": True}

    def enter(self, at: StepSymbols) -> StepSymbols:
        """Take the lengths as they are given."""
        dt = at.given["dt"]
        return replace(at, dt=at.given[_STRETCH] * dt, spacing=at.given[_SPACING] * dt)

    def stage_numbers(self, problem: Problem) -> Mapping[str, Array]:
        """Lengths by the mean one."""
        lengths = filled_lengths(problem, problem.timeline.lengths())
        return {
            _STRETCH: (lengths / problem.dt)[:, None],
            _SPACING: (spacings(lengths) / problem.dt)[:, None],
        }
