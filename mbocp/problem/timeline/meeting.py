"""Where constraints are taken on: conditions at a node, among the path constraints of a problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.problem.timeline.switches import Begin, SwitchTable
from mbocp.problem.timeline.via_constraint import AtNode
from mbocp.robot import Label
from mbocp.terms import BoundedTerm, MeetingTerm


@dataclass(frozen=True, eq=False)
class Meeting(BoundedTerm):
    """What holds at the node where a constraint is taken on, see `mbocp.problem.PathConstraint`.

    Attributes
    ----------
    begin : Begin
    term : MeetingTerm
    """

    begin: Begin
    term: MeetingTerm

    @property
    def name(self) -> str:
        """What it is called."""
        return f"{self.begin.frame.constraint.name} taken on at node {self.begin.step}"

    @property
    def span(self) -> AtNode:
        """When it holds."""
        return AtNode(self.begin.step)

    @property
    def labels(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        labels = [self.begin.frame.rows[row] for row in self.term.kept]
        node = self.begin.step
        places = [Label(f"{x.name} at node {node}", x.unit) for x in labels if self.term.has_place]
        rates = [Label(f"rate of {x.name} at node {node}", f"{x.unit}/s") for x in labels]
        return (*places, *(rates if self.term.has_rate else ()))

    @property
    def lower(self) -> Array:
        """Lower bounds, shape (rows,): zero."""
        return frozen_array(np.zeros(self.rows))

    @property
    def upper(self) -> Array:
        """Upper bounds, shape (rows,): zero."""
        return self.lower


def meetings(table: SwitchTable) -> tuple[Meeting, ...]:
    """Conditions where spans begin: frames that are to coincide do, and without an impact none moves."""
    found = []
    for begin in table.begins:
        has_place, has_rate = not begin.frame.is_anchored, not bool(table.is_impact[begin.step])
        if has_place or has_rate:
            term = MeetingTerm(begin.frame, begin.rows, has_place, has_rate)
            found.append(Meeting(begin, term))
    return tuple(found)
