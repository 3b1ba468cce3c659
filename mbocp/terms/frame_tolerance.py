"""Goals of frames with tolerances: bounds on the pose at the last node alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.robot import Label, Robot
from mbocp.terms.bounded import BoundedTerm, Structure
from mbocp.terms.frame_end import FrameShape
from mbocp.terms.frame_goal import FrameGoal
from mbocp.terms.point import Point
from mbocp.terms.span import Span


@dataclass(frozen=True)
class ToleranceTerm(Structure):
    """The structure of a tolerance: what its function depends on.

    Attributes
    ----------
    shape : FrameShape
        Either of the coordinates alone or of the axes alone.
    """

    shape: FrameShape

    kind = "tolerance"

    @property
    def is_cone(self) -> bool:
        """Whether it is about an angle."""
        return bool(self.shape.turn)

    @property
    def rows(self) -> int:
        """One for each coordinate; one for an angle."""
        return 1 if self.is_cone else len(self.shape.coordinates)

    @property
    def sizes(self) -> dict[str, int]:
        """Size of each parameter: those of the pose, and the tolerances."""
        return {**self.shape.sizes, "tolerance": self.rows}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Distances by their tolerances; the square of 2 tan(theta/2) by that of its tolerance."""
        rows = self.shape.pose(at, p)
        return ca.sumsqr(rows) / p["tolerance"] ** 2 if self.is_cone else rows / p["tolerance"]


@dataclass(frozen=True, eq=False)
class FrameTolerance(BoundedTerm):
    """A tolerance of a problem among its path constraints, see `mbocp.problem.PathConstraint`."""

    name: str
    goal: FrameGoal
    robot: Robot
    tolerance: Array  # (rows,) [m, rad]

    span = Span.at_end()

    @cached_property
    def term(self) -> ToleranceTerm:
        """Its structure, with its expression."""
        return ToleranceTerm(FrameShape.of(self.goal, self.robot))

    @property
    def labels(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        if self.term.is_cone:
            return (Label(self.name, "rad"),)
        return tuple(Label(f"{self.name}.{'xyz'[i]}", "m") for i in self.goal.target.coordinates)

    @property
    def lower(self) -> Array:
        """Lower bounds, shape (rows,) [m]."""
        return np.full(1, -np.inf) if self.term.is_cone else -self.tolerance

    @property
    def upper(self) -> Array:
        """Upper bounds, shape (rows,) [m, rad]."""
        return self.tolerance

    @property
    def inner_bounds(self) -> tuple[Array, Array]:
        """Bounds of the expression."""
        ones = np.ones(self.rows)
        return np.full(1, -np.inf) if self.term.is_cone else -ones, ones

    @property
    def numbers(self) -> dict[str, Array]:
        """Parameters by name."""
        numbers = {**FrameShape.numbers(self.goal), "tolerance": self._scale}
        return {name: numbers[name] for name in self.term.sizes}

    @property
    def _scale(self) -> Array:
        return 2.0 * np.tan(self.tolerance / 2.0) if self.term.is_cone else self.tolerance

    def value(self, h: Array) -> Array:
        """Distances and angles [m, rad]."""
        scaled: Array = h * self._scale
        return 2.0 * np.arctan(np.sqrt(h) * self._scale / 2.0) if self.term.is_cone else scaled

    def slopes(self, values: Array) -> Array:
        """Derivatives of the expression in the values."""
        if not self.term.is_cone:
            return np.ones_like(values) / self._scale
        return 4.0 * np.tan(values / 2.0) / (np.cos(values / 2.0) * self._scale) ** 2


def frame_tolerances(goals: tuple[FrameGoal, ...], robot: Robot) -> tuple[FrameTolerance, ...]:
    """Tolerances of all goals: a box for each position that has one, a cone for each orientation."""
    return tuple(FrameTolerance(name, part, robot, allowed) for name, part, allowed in _parts(goals))


def _parts(goals: Sequence[FrameGoal]) -> Iterator[tuple[str, FrameGoal, Array]]:
    """Name of each tolerance, what of the goal it is about, and how much it allows."""
    for k, goal in enumerate(goals):
        target = goal.target
        name = f"goal of {goal.name}" if len(goals) == 1 else f"goal {k + 1}, of {goal.name}"
        if goal.position_tolerance is not None:
            part = FrameGoal(target=replace(target, orientation=None, axis=None, direction=None))
            yield name, part, np.asarray(goal.position_tolerance)[target.coordinates]
        if goal.orientation_tolerance is not None:
            part = FrameGoal(target=replace(target, position=None))
            yield f"{name}, angle", part, np.array([goal.orientation_tolerance])
