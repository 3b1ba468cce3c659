r"""Limits that fall with a speed and hold within steps, too: part of what states remember.

A row bounds c u + k v, with the control u of a step and a speed v. Where v is the quadratic of the cubic
through the nodes, see `mbocp.formulation.features.within_steps`, and u is of degree two at most in the step,
the row is such a polynomial, too, and stays between the least and the largest of its Bernstein coefficients,

.. math:: c\, u_0 + k\, v_0, \qquad c\, (2 u_{1/2} - (u_0 + u_1) / 2) + k\, b, \qquad c\, u_1 + k\, v_1.

The path constraint keeps the last; the state after the step remembers the others. Of schemes whose
configurations do not say how speeds vary within a step the first alone: these take it for linear.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp._dataclass import dataclass
from mbocp.formulation.features.feature import Asked, Feature, unbounded
from mbocp.formulation.layout import Block
from mbocp.formulation.motion import Passage
from mbocp.integrators import control_basis, shares_of
from mbocp.problem.between_nodes import has_cubics
from mbocp.problem.speed_lines import speed_lines, steps_held
from mbocp.robot import Label

if TYPE_CHECKING:
    from mbocp.problem import Problem

LINES_WITHIN = "lines_within"  # the block
_GAINS, _SLOPES = "gains_of_lines", "slopes_of_lines"  # c and k
_PLACES = ("at begins of steps", "within steps")


@dataclass(frozen=True)
class LinesWithin(Feature):
    """Rows of limits that fall with a speed.

    Attributes
    ----------
    rows : tuple of (int, int)
        Of each the control and the velocity component.
    shares : tuple of float
        Where in a step controls have values; empty where they are constant, or linear.
    is_cubic : bool
        Whether speeds within steps are those of cubics.
    """

    rows: tuple[tuple[int, int], ...]
    shares: tuple[float, ...]
    is_cubic: bool

    @classmethod
    def of(cls, problem: Problem, asked: Asked) -> LinesWithin | None:
        """Return those of a problem whose limits are to hold within steps."""
        if "m" not in problem.limits_within:
            return None
        rows = [(one.control, one.dof) for one in speed_lines(problem) for _ in one.slopes]
        is_linear = problem.controls == "linear"
        shares = () if is_linear else shares_of(problem.controls, problem.scheme)
        return cls(tuple(rows), shares, has_cubics(problem))

    @property
    def places(self) -> int:
        """Places in a step at which each row is remembered."""
        return 2 if self.is_cubic else 1

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """One entry for each row, and place."""
        return (Block(LINES_WITHIN, self.places * len(self.rows)),)

    @property
    def state_key(self) -> Mapping[str, Any]:
        """Which rows they are."""
        return {LINES_WITHIN: [list(row) for row in self.rows], "is_cubic": self.is_cubic}

    @property
    def parameters(self) -> Mapping[str, int]:
        """Numbers of each row."""
        return {_GAINS: len(self.rows), _SLOPES: len(self.rows)}

    def numbers(self, problem: Problem) -> Mapping[str, Array]:
        """Numbers of each row."""
        lines = speed_lines(problem)
        gains = np.concatenate([np.full(len(one.slopes), one.gain) for one in lines])
        return {_GAINS: gains, _SLOPES: np.concatenate([one.slopes for one in lines])}

    def following(self, name: str, step: Passage) -> Any:
        """The rows at the begin of the step, and their coefficients within it."""
        controls, dofs = (list(places) for places in zip(*self.rows, strict=True))
        gains, slopes = _as_row(step.given[_GAINS]), _as_row(step.given[_SLOPES])
        u0, within = self._controls(step)
        found = [gains * _take(u0, controls) + slopes * _take(step.s0, dofs)]
        if self.is_cubic:
            b = 3.0 * step.way() / step.dt - step.s0 - step.s1
            found.append(gains * _take(within, controls) + slopes * _take(b, dofs))
        return np.hstack(found) if isinstance(step.s0, np.ndarray) else ca.vertcat(*found)

    def _controls(self, step: Passage) -> tuple[Any, Any]:
        """Controls at the begin, and the second Bernstein coefficient."""
        if not self.shares:
            begin = step.u if step.begin is None else step.begin
            return step.units_of_u * begin, step.units_of_u * (begin + step.u) / 2.0
        own, count = step.controls["own"], len(self.shares)
        nu = (own.shape[1] if isinstance(own, np.ndarray) else own.numel()) // count
        values = [_take(own, list(range(i * nu, (i + 1) * nu))) for i in range(count)]
        begin, middle, end = (
            sum(float(weight) * value for weight, value in zip(weights, values, strict=True))
            for weights in control_basis(self.shares, [0.0, 0.5, 1.0])
        )
        return step.units_of_u * begin, step.units_of_u * (2.0 * middle - (begin + end) / 2.0)

    def state_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Those of the path constraints; none in impacts, which take no time."""
        lower, upper = unbounded(problem.num_steps, self.places * len(self.rows))
        takes_time, first = ~problem.timeline.is_impact, 0
        for one in speed_lines(problem):
            held = np.flatnonzero(steps_held(one.path, problem) & takes_time)
            for begin in range(first, self.places * len(self.rows), len(self.rows)):
                columns = slice(begin, begin + one.path.rows)
                lower[held, columns], upper[held, columns] = one.path.lower, one.path.upper
            first += one.path.rows
        return {LINES_WITHIN: (lower, upper)}

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Of which constraint."""
        return names_of_lines(problem)

    def state_words(self, problem: Problem) -> Mapping[str, str]:
        """What its limits are called."""
        return {LINES_WITHIN: "path constraint within a step"}


def names_of_lines(problem: Problem) -> tuple[str, ...]:
    """Return names for the rows within steps of a problem, as of path constraints; none without any."""
    if "m" not in problem.limits_within:
        return ()
    names = [label.name for one in speed_lines(problem) for label in one.path.labels]
    places = _PLACES if has_cubics(problem) else _PLACES[:1]
    return tuple(f"{name} {place}" for place in places for name in names)


def _take(values: Any, places: list[int]) -> Any:
    """Entries of a vector of symbols, or columns of an array with a row for each step."""
    return values[:, places] if isinstance(values, np.ndarray) else values[places, 0]


def _as_row(numbers: Any) -> Any:
    return numbers[None] if isinstance(numbers, np.ndarray) and numbers.ndim == 1 else numbers
