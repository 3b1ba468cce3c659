"""Forces of constraints that states remember for the path constraints on contacts: rows, unit, values."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.layout import StateLayout
from mbocp.problem import Problem

__all__ = ["reaction_rows", "reactions_along", "unit_of_reactions"]


def reaction_rows(problem: Problem) -> tuple[int, ...]:
    """Rows of the robot's constraints whose forces states remember, in rising order."""
    return tuple(sorted({row for contact in problem.contacts for row in contact.term.of_rows}))


def unit_of_reactions(problem: Problem) -> float:
    """What remembered forces count in [N, N m]."""
    return max((contact.scale for contact in problem.contacts), default=1.0)


def reactions_along(problem: Problem, at: StateLayout, xs: Array) -> Array:
    """Forces of the robot's constraints in the steps to the nodes 1..N, shape (N, rows); zero where unknown.

    Parameters
    ----------
    problem : Problem
    at : StateLayout
    xs : ndarray, shape (N + 1, nx)
        States that remember them.
    """
    rows = reaction_rows(problem)
    found = np.zeros((len(xs) - 1, rows[-1] + 1 if rows else 0))
    if rows:
        found[:, list(rows)] = unit_of_reactions(problem) * xs[1:, at.remembered["reaction"]]
    return found
