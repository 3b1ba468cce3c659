"""Forces of constraints that states remember, for the path constraints on contacts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.features.feature import Asked, Feature
from mbocp.formulation.features.switches import labels_of
from mbocp.formulation.layout import Block, StateLayout
from mbocp.formulation.motion import Passage
from mbocp.robot import Label
from mbocp.terms.contact import ContactTerm

if TYPE_CHECKING:
    from mbocp.problem import Problem


@dataclass(frozen=True)
class Reactions(Feature):
    """Rows of the robot's constraints whose forces states remember, in rising order."""

    rows: tuple[int, ...]

    @classmethod
    def of(cls, problem: Problem, asked: Asked) -> Reactions | None:
        """Return those that path constraints look at."""
        rows = _rows_of(term for term in asked.path if isinstance(term, ContactTerm))
        return cls(rows) if rows else None

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """A force for each; impacts have impulses in their place."""
        return (Block("reaction", len(self.rows), has_unit=True, has_impacts=True),)

    @property
    def state_key(self) -> Mapping[str, Any]:
        """Which rows they are."""
        return {"reactions": self.rows}

    def following(self, name: str, step: Passage) -> Any:
        """Forces in the step."""
        return step.forces(self.rows) / step.units[name]

    def show(self, name: str, value: ca.SX) -> ca.SX:
        """Forces at their rows, and zeros at those that are not remembered."""
        found = ca.SX.zeros(self.rows[-1] + 1)
        found[list(self.rows)] = value
        return found

    def units(self, problem: Problem) -> Mapping[str, float]:
        """The largest scale of a contact [N, N m]."""
        return {"reaction": _unit(problem)}

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Of which constraint."""
        labels = labels_of(problem)
        return [f"force of {labels[row].name}" for row in self.rows]


def _rows_of(terms: Iterable[ContactTerm]) -> tuple[int, ...]:
    return tuple(sorted({row for term in terms for row in term.of_rows}))


def _unit(problem: Problem) -> float:
    return max((contact.scale for contact in problem.contacts), default=1.0)


def reactions_along(problem: Problem, at: StateLayout, xs: Array) -> Array:
    """Return forces of the robot's constraints in the steps to the nodes 1..N, shape (N, rows).

    Zero where they are not remembered.

    Parameters
    ----------
    problem : Problem
    at : StateLayout
    xs : ndarray, shape (N + 1, nx)
        States that remember them.
    """
    rows = _rows_of(contact.term for contact in problem.contacts)
    found = np.zeros((len(xs) - 1, rows[-1] + 1 if rows else 0))
    if rows:
        found[:, list(rows)] = _unit(problem) * xs[1:, at.states["reaction"]]
    return found
