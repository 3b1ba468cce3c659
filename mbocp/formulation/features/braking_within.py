r"""Joints that can always stop, within steps, too: part of what states remember.

Along the cubic through the nodes of a step, see `mbocp.formulation.features.within_steps`, angle and speed
stay within the convex hull of their Bernstein coefficients of degree three,

.. math:: (q_0, v_0), \quad \bigl(q_0 + \tfrac{h v_0}{3}, \tfrac{v_0 + 2 b}{3}\bigr), \quad
    \bigl(q_1 - \tfrac{h v_1}{3}, \tfrac{2 b + v_1}{3}\bigr), \quad (q_1, v_1).

Where a joint stands that brakes, see `mbocp.terms.braking`, is convex in both: where it keeps its
limit at these four places it does so in the whole step. Nodes keep theirs, and the state after the step
remembers those of the other two. Where controls are constant in steps speeds bulge less between nodes, and a
little more reserve there is cheaper, see `mbocp.strategies`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.features.feature import Feature, StepRequests, infinite_bounds
from mbocp.formulation.features.lines_within import entry
from mbocp.formulation.layout import Block
from mbocp.formulation.motion import Passage
from mbocp.problem import Problem
from mbocp.problem.between_nodes import has_cubics
from mbocp.problem.path import PathConstraint
from mbocp.problem.speed_lines import find_steps_held
from mbocp.robot import Label
from mbocp.terms.braking import Braking, stop

BRAKING_WITHIN = "braking_within"  # the block
_RESERVES, _DECELERATIONS = "reserves_within", "decelerations_within"
_PLACES = ("after begins of steps", "before ends of steps")


@dataclass(frozen=True)
class BrakingWithin(Feature):
    """Rows of braking joints: of each the place of its angle, that of its velocity, and the limit's side."""

    rows: tuple[tuple[int, int, int], ...]

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> BrakingWithin | None:
        """Return those of a problem whose speeds and controls vary within a step."""
        rows, model = [], problem.robot.model
        for path, term in _brakings(problem):
            joint = model.joints[model.frames[path.frame].parentJoint]
            rows += [(joint.idx_q, joint.idx_v, side) for side in term.sides]
        return cls(tuple(rows)) if rows else None

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """One entry for each row, and place."""
        return (Block(BRAKING_WITHIN, len(_PLACES) * len(self.rows)),)

    @property
    def state_key(self) -> Mapping[str, Any]:
        """Which rows they are."""
        return {BRAKING_WITHIN: [list(row) for row in self.rows]}

    @property
    def parameters(self) -> Mapping[str, int]:
        """Numbers of each row."""
        return {_RESERVES: len(self.rows), _DECELERATIONS: len(self.rows)}

    def numbers(self, problem: Problem) -> Mapping[str, Array]:
        """Numbers of each row."""
        return {
            name: np.concatenate([np.repeat(path.number(key), path.rows) for path, _ in _brakings(problem)])
            for name, key in ((_RESERVES, "reserve"), (_DECELERATIONS, "deceleration"))
        }

    def next_value(self, name: str, step: Passage) -> Any:
        """Angles at which a joint would stand that brakes from either place [rad]."""
        way, h, v0, v1 = step.way(), step.dt, step.s0, step.s1
        b = 3.0 * way / h - v0 - v1
        is_array = isinstance(b, np.ndarray)
        largest = np.maximum if is_array else ca.fmax
        values = []
        for is_late in range(len(_PLACES)):
            moved = way - h * v1 / 3.0 if is_late else h * v0 / 3.0
            speeds = (2.0 * b + (v1 if is_late else v0)) / 3.0
            for i, (at_q, dof, side) in enumerate(self.rows):
                q, v = entry(step.q0, at_q) + entry(moved, dof), entry(speeds, dof)
                numbers = step.given[_RESERVES][i], step.given[_DECELERATIONS][i]
                values.append(stop(q, v, side, *numbers, largest))
        return np.column_stack(values) if is_array else ca.vertcat(*values)

    def state_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Those of the path constraints; none in impacts, which take no time."""
        lower, upper = infinite_bounds(problem.num_steps, len(self.rows))
        first = 0
        for path, _ in _brakings(problem):
            held, columns = find_steps_held(path, problem), slice(first, first + path.rows)
            held &= ~problem.timeline.is_impact
            lower[held, columns], upper[held, columns] = path.lower, path.upper
            first += path.rows
        return {BRAKING_WITHIN: (np.tile(lower, len(_PLACES)), np.tile(upper, len(_PLACES)))}

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Of which constraint."""
        return name_braking_rows(problem)

    def state_words(self, problem: Problem) -> Mapping[str, str]:
        """What its limits are called."""
        return {BRAKING_WITHIN: "path constraint within a step"}


def name_braking_rows(problem: Problem) -> tuple[str, ...]:
    """Return names for the rows within steps of a problem, as of path constraints; none without any."""
    labels = [label for path, _ in _brakings(problem) for label in path.labels]
    return tuple(f"{label.name} {place}" for place in _PLACES for label in labels)


def _brakings(problem: Problem) -> list[tuple[PathConstraint, Braking]]:
    """Constraints of joints whose angles are numbers, with their terms; none where cubics hardly bulge."""
    if not has_cubics(problem) or problem.controls == "constant":
        return []
    model = problem.robot.model
    pairs = ((path, path.term) for path in problem.frame_constraints)
    return [
        (path, term)
        for path, term in pairs
        if isinstance(term, Braking) and model.joints[model.frames[path.frame].parentJoint].nq == 1
    ]
