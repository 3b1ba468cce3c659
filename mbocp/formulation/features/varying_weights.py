"""Weights of the cost that differ from step to step: each step takes its share of them as a parameter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mbocp._arrays import Array, dataclass
from mbocp.formulation.features.feature import Feature, StepRequests
from mbocp.formulation.steps import StepSymbols
from mbocp.problem import Problem


@dataclass(frozen=True)
class VaryingWeights(Feature):
    """Names and sizes of such weights."""

    sizes: tuple[tuple[str, int], ...]

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> VaryingWeights | None:
        """Return it where phases have weights of their own that a term knows."""
        known = {name for term in asked.cost for name in term.weights}
        shares = problem.weight_shares
        sizes = tuple((name, rows.shape[1]) for name, rows in shares.items() if name in known)
        return cls(sizes) if sizes else None

    @property
    def stage_parameters(self) -> Mapping[str, int]:
        """Shares of the weights."""
        return {_share_of(name): size for name, size in self.sizes}

    @property
    def stage_key(self) -> Mapping[str, Any]:
        """Which weights they are."""
        return {"varying": [name for name, _ in self.sizes]}

    def enter(self, at: StepSymbols) -> StepSymbols:
        """Take the share of each weight that counts in the step."""
        shares = {name: at.given[name] * at.given[_share_of(name)] for name, _ in self.sizes}
        return replace(at, given={**at.given, **shares})

    def stage_numbers(self, problem: Problem) -> Mapping[str, Array]:
        """Shares of all steps."""
        shares = problem.weight_shares
        return {_share_of(name): shares[name] for name, _ in self.sizes}


def _share_of(name: str) -> str:
    return f"{name}.share"
