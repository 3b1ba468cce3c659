r"""Forces of feet that may leave the ground: controls that impulses of held frames are equal to.

A foot that is free is a held frame that never holds, see `mbocp.integrators.switched`: its impulses
:math:`\Lambda` have rows :math:`\Lambda - \Delta t\, w` in the place of constraints, with controls w. So
states remember them, and results have them, as they do those of feet that stand. One more control for each
foot bounds its speed along the ground, see `mbocp.terms.free_contact`.

Nothing tells apart how feet share a load, nor what bounds a foot in the air: a small part of the weight of
efforts is on all these controls.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.features.changing_constraints import reaction_unit, reactions_along
from mbocp.formulation.features.feature import Feature, StepRequests, infinite_bounds
from mbocp.formulation.layout import Block, StateLayout
from mbocp.formulation.motion import Motion, Passage
from mbocp.formulation.steps import StepSymbols, unit_of
from mbocp.problem import Problem
from mbocp.problem.free_contact_bounds import FreeContactBounds
from mbocp.robot import Label
from mbocp.robot.nodes import between
from mbocp.terms.free_contact import SLIP, FreeContactTerm

_FEET = "feet"  # the controls w
_WEIGHT = "feet.weight"
_PART = 1e-3  # of the weight of efforts
_GROSS_DEPTH = 0.01  # [m] between nodes: what is deeper in the ground does not stand on it


@dataclass(frozen=True)
class FreeContacts(Feature):
    """Rows of the impulses that are found, foot by foot."""

    rows: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> FreeContacts | None:
        """Return those of the path constraints."""
        rows = tuple(term.of_rows for term in asked.path if isinstance(term, FreeContactTerm))
        return cls(rows) if rows else None

    @property
    def _places(self) -> list[int]:
        return [row for rows in self.rows for row in rows]

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """A bound of the speed of each foot."""
        return (Block(SLIP, len(self.rows)),)

    def controls(self, nu: int) -> Mapping[str, int]:
        """Forces, by the unit of reactions, and bounds."""
        return {_FEET: len(self._places), SLIP: len(self.rows)}

    weights = frozenset({_WEIGHT})

    @property
    def parameters(self) -> Mapping[str, int]:
        """The weight of all of them."""
        return {_WEIGHT: 1}

    @property
    def state_key(self) -> Mapping[str, Any]:
        """Whose they are."""
        return {"free_contacts": self.rows}

    def enter(self, at: StepSymbols) -> StepSymbols:
        """Say which impulses the feet have."""
        assert at.switched is not None
        given = ca.SX.zeros(at.switched.active.numel())
        given[self._places] = at.dt * at.given[unit_of("reaction")] * at.named_inputs[_FEET]
        return replace(at, switched=at.switched._replace(given=given))

    def next_value(self, name: str, step: Passage) -> Any:
        """The control of the step."""
        return step.controls[SLIP]

    def idle_cost(self, at: StepSymbols) -> ca.SX:
        """Half the weighted square of all of them."""
        found = ca.vertcat(at.named_inputs[_FEET], at.named_inputs[SLIP])
        return at.dt * at.given[_WEIGHT] * ca.sumsqr(found) / 2.0

    def numbers(self, problem: Problem) -> Mapping[str, Array]:
        """A part of the weight of efforts, of forces in the unit of reactions."""
        weights = problem.heaviest_cost.on_squares
        least = min((float(weight) for weight in weights if weight > 0.0), default=1.0)
        return {_WEIGHT: np.array([_PART * least * reaction_unit(problem) ** 2])}

    def control_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """None: path constraints have them."""
        return {_FEET: infinite_bounds(1, len(self._places)), SLIP: infinite_bounds(1, len(self.rows))}

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Of which foot."""
        return [f"slip of {name}" for name in _names(problem)]

    def control_words(self, problem: Problem) -> Sequence[str]:
        """Of which foot."""
        names = _names(problem)
        return [*(f"limit of the force of {name}" for name in names for _ in range(3))] + [
            f"limit of the slip of {name}" for name in names
        ]

    def controls_of(self, problem: Problem, motion: Motion) -> Mapping[str, Array]:
        """Forces that are known, else zero; the least bounds of the speeds."""
        forces = np.zeros((problem.num_steps, len(self._places)))
        if motion.lams.size:
            forces = motion.lams[:, self._places] / reaction_unit(problem)
        slips = [foot.slips(problem.robot, motion.qs[1:], motion.vs[1:]) for foot in _feet(problem)]
        return {_FEET: forces, SLIP: np.column_stack(slips)}


def describe_free_contacts(problem: Problem, at: StateLayout, xs: Array, qs: Array) -> tuple[str, bool]:
    """Say by how much feet that may leave the ground miss its laws, and whether by far; "" where none may.

    Parameters
    ----------
    problem : Problem
    at : StateLayout
    xs : ndarray, shape (N + 1, nx)
        States, which remember forces.
    qs : ndarray, shape (N + 1, nq)
        Configurations at the nodes [m, rad, unit quaternion].
    """
    feet = _feet(problem)
    if not feet:
        return "", False
    robot, lams = problem.robot, reactions_along(problem, at, xs)
    middles = between(robot, qs[:-1], qs[1:], np.full(len(qs) - 1, 0.5))
    products = [one.force.wrenches(lams)[:, 0] * one.heights(robot, qs[1:]) for one in feet]
    below = max(float(-one.heights(robot, middles).min()) for one in feet)
    words = (
        f"contacts are found (experimental): force times height is at most {np.max(products):.1e} N m, and "
        f"feet are {1e3 * max(below, 0.0):.2g} mm below the ground between nodes at most"
    )
    return words, below > _GROSS_DEPTH


def _feet(problem: Problem) -> list[FreeContactBounds]:
    return [one for one in problem.inequalities if isinstance(one, FreeContactBounds)]


def _names(problem: Problem) -> list[str]:
    return [one.force.contact.constraint for one in _feet(problem)]
