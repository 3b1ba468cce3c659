r"""Numbers of the robot that are found with the motion, as a part of the state that stays.

With s the way of each number from its start p_0, in units of the range between its bounds, and a control w
that sets it in the first step alone,

.. math:: s_{k+1} = s_k + e_k w_k, \qquad e_0 = 1, \quad e_k = 0 \text{ in all other steps}, \qquad s_0 = 0,

and the equations of motion take :math:`p = p_0 + r (s_k + e_k w_k)`. So the recursion carries them, and work
stays linear in the number of steps. Where e is 0 half the square of w is added to the cost, which is zero at
the optimum. The cost of p itself is that of the first step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.features.feature import Asked, Feature, unbounded
from mbocp.formulation.features.passage import Passage
from mbocp.formulation.layout import Block, StateLayout
from mbocp.formulation.motion import Motion
from mbocp.formulation.steps import HAS_BEFORE, StepSymbols
from mbocp.mechanics import JointMechanics, Mechanics
from mbocp.robot import Label
from mbocp.robot.named_numbers import put

if TYPE_CHECKING:
    from mbocp.problem import Problem

_FOUND = "found"
_START, _RANGE = "found.start", "found.range"
_LINEAR, _SQUARE, _REFERENCE = "found.linear", "found.square", "found.reference"


@dataclass(frozen=True)
class FoundNumbers(Feature):
    """Words of the robot's numbers that each parameter is the value of."""

    words: tuple[tuple[str, ...], ...]

    @classmethod
    def of(cls, problem: Problem, asked: Asked) -> FoundNumbers | None:
        """Return those of the problem."""
        return cls(tuple(one.words for one in problem.parameter)) if problem.parameter else None

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """One entry for each."""
        return (Block(_FOUND, len(self.words), adds_up=True),)

    def controls(self, nu: int) -> Mapping[str, int]:
        """What sets them."""
        return {_FOUND: len(self.words)}

    @property
    def parameters(self) -> Mapping[str, int]:
        """Start and range of each, and what it costs."""
        return dict.fromkeys((_START, _RANGE, _LINEAR, _SQUARE, _REFERENCE), len(self.words))

    @property
    def end_parameters(self) -> Mapping[str, int]:
        """Start and range."""
        return dict.fromkeys((_START, _RANGE), len(self.words))

    @property
    def asks_for_first(self) -> bool:
        """They are set in the first step alone."""
        return True

    @property
    def state_key(self) -> Mapping[str, Any]:
        """Which they are."""
        return {_FOUND: self.words}

    def equations(
        self, plain: Mechanics, states: Mapping[str, ca.SX], given: Mapping[str, ca.SX]
    ) -> Mechanics:
        """Return those with the numbers of the state."""
        return self._equations(plain, given, states[_FOUND])

    def _equations(self, plain: Mechanics, given: Mapping[str, ca.SX], s: ca.SX) -> Mechanics:
        assert isinstance(plain, JointMechanics)  # problems in natural coordinates have no parameters
        robot, values = plain.robot, given[_START] + given[_RANGE] * s
        before = dict(zip(robot.varying, ca.vertsplit(plain.numbers), strict=True))
        after = put(
            robot, before, [(word, values[k]) for k, words in enumerate(self.words) for word in words]
        )
        numbers = ca.vertcat(*[after[number] for number in robot.varying])
        return plain.with_numbers(numbers, s if s.is_valid_input() else None)

    def enter(self, at: StepSymbols) -> StepSymbols:
        """Let the equations of motion take them."""
        s = at.at0[at.space.layout.states[_FOUND]] + (1 - at.has_before) * at.named_inputs[_FOUND]
        equations = partial(self._equations, at.mechanics, at.given)
        return replace(at, mechanics=equations(s), found=s, of_found=equations)

    def following(self, name: str, step: Passage) -> Any:
        """What was before, and e w."""
        return step.before[name] + (1.0 - step.has_before) * step.controls[_FOUND]

    def idle_cost(self, at: StepSymbols) -> ca.SX:
        """What they cost; half the square of controls after the first step."""
        p = at.given[_START] + at.given[_RANGE] * at.found
        cost = ca.dot(at.given[_LINEAR], p) + ca.dot(at.given[_SQUARE], (p - at.given[_REFERENCE]) ** 2)
        return (1 - at.has_before) * cost + at.given[HAS_BEFORE] * ca.sumsqr(at.named_inputs[_FOUND]) / 2.0

    def numbers(self, problem: Problem) -> Mapping[str, Array]:
        """What the problem says of them."""
        given = problem.parameter
        return {
            _START: np.array([one.start for one in given]),
            _RANGE: _ranges(problem),
            _LINEAR: np.array([one.cost.linear for one in given]),
            _SQUARE: np.array([one.cost.square for one in given]),
            _REFERENCE: np.array([one.cost.reference for one in given]),
        }

    def control_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Their own in the first step, and none after it."""
        lower, upper = unbounded(problem.num_steps, len(self.words))
        lower[0], upper[0] = _sides(problem)
        return {_FOUND: (lower, upper)}

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Of which."""
        return [f"memory of {one.name}" for one in problem.parameter]

    def control_words(self, problem: Problem) -> Sequence[str]:
        """Of which."""
        return [f"bound of parameter {one.name}" for one in problem.parameter]

    def controls_of(self, problem: Problem, motion: Motion) -> Mapping[str, Array]:
        """From the start to the values of the motion."""
        found = np.zeros((problem.num_steps, len(self.words)))
        if motion.found.size:
            found[0] = np.clip(
                (motion.found - self.numbers(problem)[_START]) / _ranges(problem), *_sides(problem)
            )
        return {_FOUND: found}

    def read(self, problem: Problem, at: StateLayout, xs: Array, us: Array, motion: Motion) -> Motion:
        """Their values."""
        way = us[0, at.controls[_FOUND]]
        return replace(motion, found=self.numbers(problem)[_START] + _ranges(problem) * way)


def _ranges(problem: Problem) -> Array:
    return np.array([one.upper - one.lower for one in problem.parameter])


def _sides(problem: Problem) -> tuple[Array, Array]:
    sides = np.array([(one.lower - one.start, one.upper - one.start) for one in problem.parameter])
    lower, upper = sides.T / _ranges(problem)
    return lower, upper
