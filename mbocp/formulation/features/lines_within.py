r"""Limits that fall with a speed and hold within steps, too: part of what states remember.

A row bounds c u + k v, with the control u of a step and a speed v, or a + k v with an acceleration a. The
path constraint keeps its value at the end of a step, of accelerations with their mean. The state after the
step remembers

.. math:: c\, u_0 + k\, v_0, \qquad \text{or} \quad a_0 + k\, v_0, \quad a_1 + k\, v_1,

at its begin, and with the accelerations of the cubic through the nodes at both ends, see
`mbocp.formulation.features.within_steps`. Between them a row is a polynomial of degree two, and leaves the
larger of its ends by the square of the step at most, but where controls have three values in a step: there
its Bernstein coefficient in the middle is remembered, too. Of schemes whose configurations do not say how
speeds vary within a step a_0 is the mean, and a_1 is left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.features.feature import Feature, StepRequests, infinite_bounds
from mbocp.formulation.layout import Block
from mbocp.formulation.motion import Passage
from mbocp.integrators import control_basis, shares_of
from mbocp.problem import Problem
from mbocp.problem.between_nodes import has_cubics
from mbocp.problem.speed_lines import SpeedLines, find_steps_held, speed_lines
from mbocp.robot import Label

LINES_WITHIN = "lines_within"  # the block
_GAINS, _SLOPES = "gains_of_lines", "slopes_of_lines"  # c and k
_PLACES = ("at begins of steps", "within steps", "at ends of steps")


@dataclass(frozen=True)
class LinesWithin(Feature):
    """Rows of limits that fall with a speed.

    Attributes
    ----------
    rows : tuple of (int, int, int)
        Of each the place in the step, the control, -1 for an acceleration, and the velocity component.
    shares : tuple of float
        Where in a step controls have values; empty where they are constant, or linear.
    """

    rows: tuple[tuple[int, int, int], ...]
    shares: tuple[float, ...]

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> LinesWithin | None:
        """Return those of a problem whose limits are to hold within steps."""
        rows = [
            (place, -1 if one.control is None else one.control, one.dof)
            for place, one in _parts(problem)
            for _ in one.slopes
        ]
        is_linear = problem.controls == "linear"
        shares = () if is_linear else shares_of(problem.controls, problem.scheme)
        return cls(tuple(rows), shares) if rows else None

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """One entry for each row."""
        return (Block(LINES_WITHIN, len(self.rows)),)

    @property
    def state_key(self) -> Mapping[str, Any]:
        """Which rows they are."""
        return {LINES_WITHIN: [list(row) for row in self.rows]}

    @property
    def parameters(self) -> Mapping[str, int]:
        """Numbers of each row."""
        return {_GAINS: len(self.rows), _SLOPES: len(self.rows)}

    def numbers(self, problem: Problem) -> Mapping[str, Array]:
        """Numbers of each row."""
        lines = [one for _, one in _parts(problem)]
        gains = np.concatenate([np.full(len(one.slopes), one.gain) for one in lines])
        return {_GAINS: gains, _SLOPES: np.concatenate([one.slopes for one in lines])}

    def next_value(self, name: str, step: Passage) -> Any:
        """The rows at their places in the step."""
        speeds, rates, controls = [step.s0], [step.acceleration], self._controls(step)
        if any(place for place, _, _ in self.rows):  # of cubics
            b = 3.0 * step.way() / step.dt - step.s0 - step.s1
            ends = [2.0 * (b - step.s0) / step.dt, 2.0 * (step.s1 - b) / step.dt]
            speeds, rates = [step.s0, b, step.s1], [ends[0], step.acceleration, ends[1]]
        gains, slopes = step.given[_GAINS], step.given[_SLOPES]
        values = []
        for i, (place, control, dof) in enumerate(self.rows):
            value = entry(rates[place], dof) if control < 0 else gains[i] * entry(controls[place], control)
            values.append(value + slopes[i] * entry(speeds[place], dof))
        return np.column_stack(values) if isinstance(step.s0, np.ndarray) else ca.vertcat(*values)

    def _controls(self, step: Passage) -> tuple[Any, ...]:
        """Controls at the begin of the step; their second Bernstein coefficient."""
        if not self.shares:
            return (step.units_of_u * (step.u if step.begin is None else step.begin),)
        own, count = step.controls["own"], len(self.shares)
        is_array = isinstance(own, np.ndarray)
        values = np.split(own, count, axis=1) if is_array else ca.vertsplit(own, own.numel() // count)
        begin, middle, end = (
            sum(float(weight) * value for weight, value in zip(weights, values, strict=True))
            for weights in control_basis(self.shares, [0.0, 0.5, 1.0])
        )
        return step.units_of_u * begin, step.units_of_u * (2.0 * middle - (begin + end) / 2.0)

    def state_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Those of the path constraints; none in impacts, which take no time."""
        lower, upper = infinite_bounds(problem.num_steps, len(self.rows))
        takes_time, first = ~problem.timeline.is_impact, 0
        for _, one in _parts(problem):
            held, columns = (
                find_steps_held(one.path, problem) & takes_time,
                slice(first, first + one.path.rows),
            )
            if one.control is not None and problem.controls == "linear":  # those before end with the same
                held[1:] &= ~held[:-1]
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
    return tuple(f"{label.name} {_PLACES[k]}" for k, one in _parts(problem) for label in one.path.labels)


def _parts(problem: Problem) -> list[tuple[int, SpeedLines]]:
    """Places in a step, and the rows that are remembered of each."""
    if "m" not in problem.limits_within:
        return []
    lines, is_cubic = speed_lines(problem), has_cubics(problem)
    found = [(0, one) for one in lines]
    if is_cubic and len(shares_of(problem.controls, problem.scheme)) > 2:
        found += [(1, one) for one in lines if one.control is not None]
    return found + [(2, one) for one in lines if one.control is None and is_cubic]


def entry(values: Any, place: int) -> Any:
    """An entry of a vector of symbols, or a column of an array with a row for each step."""
    return values[:, place] if isinstance(values, np.ndarray) else values[place]
