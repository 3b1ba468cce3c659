"""Stops of a guess: nodes that a line goes through, of which several are one instant about impacts."""

from __future__ import annotations

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.problem import Goal


@dataclass(frozen=True, eq=False)
class Stop:
    """A node that a line goes through.

    Attributes
    ----------
    node : int
        Of those that an instant has the first: impacts take no time.
    q : ndarray, shape (nq,)
    goal : Goal, optional
        What is asked for there.
    """

    node: int
    q: Array
    goal: Goal | None = None


def first_of(is_impact: BoolArray, node: int) -> int:
    """Return the first node of an instant."""
    while node and is_impact[node - 1]:
        node -= 1
    return node


def instant(is_impact: BoolArray, node: int) -> slice:
    """Return all nodes of an instant, from its first."""
    last = node
    while last < len(is_impact) and is_impact[last]:
        last += 1
    return slice(node, last + 1)
