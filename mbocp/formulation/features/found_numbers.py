r"""Numbers of the robot that are found with the motion, as a part of the state that stays.

With s the way of each number from its lower bound to its upper one, and a control w that sets it in the first
step alone,

.. math:: s_{k+1} = s_k + e_k w_k, \qquad e_0 = 1, \quad e_k = 0 \text{ in all other steps}, \qquad s_0 = 0,

and the equations of motion take
:math:`\underline{p} + (\overline{p} - \underline{p}) (s_k + e_k w_k)`. So the recursion carries them, and
work stays linear in the number of steps. Where e is 0 half the square of w is added to the cost, which is
zero at the optimum. The cost of p itself is that of the first step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.features.feature import Feature, StepRequests, infinite_bounds
from mbocp.formulation.layout import Block, StateLayout
from mbocp.formulation.motion import Motion, Passage
from mbocp.formulation.steps import HAS_BEFORE, StepSymbols
from mbocp.mechanics import JointMechanics, Mechanics
from mbocp.problem import Problem
from mbocp.robot import Label
from mbocp.robot.named_numbers import put

_FOUND = "found"
_LEAST, _RANGE = "found.least", "found.range"
_LINEAR, _SQUARE, _REFERENCE = "found.linear", "found.square", "found.reference"


@dataclass(frozen=True)
class FoundNumbers(Feature):
    """Words of the robot's numbers that each parameter is the value of."""

    words: tuple[tuple[str, ...], ...]

    asks_for_first = True  # they are set in the first step alone
    weights = frozenset({_LINEAR, _SQUARE})

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> FoundNumbers | None:
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
        """Bounds of each, and what it costs."""
        return dict.fromkeys((_LEAST, _RANGE, _LINEAR, _SQUARE, _REFERENCE), len(self.words))

    @property
    def end_parameters(self) -> Mapping[str, int]:
        """Bounds."""
        return dict.fromkeys((_LEAST, _RANGE), len(self.words))

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
        robot, values = plain.robot, given[_LEAST] + given[_RANGE] * s
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

    def next_value(self, name: str, step: Passage) -> Any:
        """What was before, and e w."""
        return step.before[name] + (1.0 - step.has_before) * step.controls[_FOUND]

    def idle_cost(self, at: StepSymbols) -> ca.SX:
        """What they cost; half the square of controls after the first step."""
        p = at.given[_LEAST] + at.given[_RANGE] * at.found
        cost = ca.dot(at.given[_LINEAR], p) + ca.dot(at.given[_SQUARE], (p - at.given[_REFERENCE]) ** 2)
        return (1 - at.has_before) * cost + at.given[HAS_BEFORE] * ca.sumsqr(at.named_inputs[_FOUND]) / 2.0

    def numbers(self, problem: Problem) -> Mapping[str, Array]:
        """What the problem says of them."""
        given = problem.parameter
        return {
            **_bounds(problem),
            _LINEAR: np.array([one.cost.linear for one in given]),
            _SQUARE: np.array([one.cost.square for one in given]),
            _REFERENCE: np.array([one.cost.reference for one in given]),
        }

    def control_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Their own in the first step, and none after it."""
        lower, upper = infinite_bounds(problem.num_steps, len(self.words))
        lower[0], upper[0] = 0.0, 1.0
        return {_FOUND: (lower, upper)}

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Of which."""
        return [f"memory of {one.name}" for one in problem.parameter]

    def control_words(self, problem: Problem) -> Sequence[str]:
        """Of which."""
        return [f"bound of parameter {one.name}" for one in problem.parameter]

    def controls_of(self, problem: Problem, motion: Motion) -> Mapping[str, Array]:
        """Where the values of the motion are between bounds, or those of the start."""
        starts = np.array([one.start for one in problem.parameter])
        of_bounds, shares = _bounds(problem), np.zeros((problem.num_steps, len(self.words)))
        values = motion.found if motion.found.size else starts
        shares[0] = np.clip((values - of_bounds[_LEAST]) / of_bounds[_RANGE], 0.0, 1.0)
        return {_FOUND: shares}

    def read(self, problem: Problem, at: StateLayout, xs: Array, us: Array, motion: Motion) -> Motion:
        """Their values."""
        of_bounds = _bounds(problem)
        found = of_bounds[_LEAST] + of_bounds[_RANGE] * us[0, at.controls[_FOUND]]
        return replace(motion, found=found)


def _bounds(problem: Problem) -> dict[str, Array]:
    lower, upper = np.array([(one.lower, one.upper) for one in problem.parameter]).T
    return {_LEAST: lower, _RANGE: upper - lower}
