"""Where constraints are taken on: conditions at a node, among the path constraints of a problem."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.mechanics import JointMechanics
from mbocp.problem.timeline.switches import Begin, SwitchTable
from mbocp.problem.timeline.via_constraint import AtNode
from mbocp.robot import Label, Robot
from mbocp.terms import MeetingTerm, Point

__all__ = ["Meeting", "meetings"]


@dataclass(frozen=True, eq=False)
class Meeting:
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
    def rows(self) -> int:
        """Number of its values."""
        return self.term.rows

    def structure(self, rotations: str) -> MeetingTerm:
        """Its structure, the same in all coordinates of attitudes."""
        return self.term

    def numbers_in(self, rotations: str) -> dict[str, Array]:
        """No parameters."""
        return {}

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

    @property
    def inner_bounds(self) -> tuple[Array, Array]:
        """Bounds of the expression."""
        return self.lower, self.upper

    def slopes(self, values: Array) -> Array:
        """Derivatives of the expression in the values."""
        return np.ones_like(values)

    def values(self, robot: Robot, q: Array, v: Array) -> Array:
        """Values at one state, shape (rows,)."""
        found: Array = self.values_along(robot, q[None], v[None], np.zeros((1, robot.nu)))[0]
        return found

    def values_along(self, robot: Robot, qs: Array, vs: Array, us: Array) -> Array:
        """Values at each of n states, shape (n, rows)."""
        q, v = ca.SX.sym("q", robot.nq), ca.SX.sym("v", robot.nv)
        h = self.term.expression(Point(JointMechanics(robot), q, v), {})
        found: Array = np.asarray(ca.Function("h", [q, v], [ca.densify(h)]).map(len(qs))(qs.T, vs.T)).T
        return found

    def check_frames(self, robot: Robot) -> None:
        """Nothing: they were looked up by name."""


def meetings(table: SwitchTable) -> tuple[Meeting, ...]:
    """Conditions where spans begin: frames that are to coincide do, and without an impact none moves."""
    found = []
    for begin in table.begins:
        has_place, has_rate = not begin.frame.is_anchored, not bool(table.is_impact[begin.step])
        if has_place or has_rate:
            term = MeetingTerm(begin.frame, begin.rows, has_place, has_rate)
            found.append(Meeting(begin, term))
    return tuple(found)
