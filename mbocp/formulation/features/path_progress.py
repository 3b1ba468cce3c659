r"""Progress of frames along paths: part of what states remember, and one more control for each.

With s the progress along a path, w its pace, and a stage parameter e that is one over the number of steps on
the path and 0 in all others,

.. math:: s_{k+1} = s_k + e_k w_k, \qquad s_0 = 0, \qquad w_k \ge -\epsilon.

So paces are about one. Where e is 0 nothing depends on w; half its square is added to the cost there, which
is zero at the optimum. A frame that comes to rest has a pace of zero in its last step, whatever the others
are: the small :math:`\epsilon` leaves solvers room there. An upper bound keeps a frame from standing still
where a path is closed or crosses itself, its progress leaping over a loop in one step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.features.feature import Feature, StepRequests
from mbocp.formulation.layout import Block
from mbocp.formulation.motion import Motion, Passage
from mbocp.formulation.steps import StepSymbols
from mbocp.robot import Label

if TYPE_CHECKING:
    from mbocp.problem import PathConstraint, Problem

_ADVANCES = "advances"  # the stage parameters e
_LEAST, _MOST = -1e-2, 8.0  # paces
_MOST_OF_PATH = 1.0 / 3.0  # in one step, where steps are few
_ROOM = 3.0  # times the mean pace, at least


@dataclass(frozen=True)
class Progress(Feature):
    """How many paths are followed."""

    num_paths: int

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> Progress | None:
        """Return those of the path constraints."""
        count = sum("progress" in term.remembers for term in asked.path)
        return cls(count) if count else None

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """Progress along each path."""
        return (Block("progress", self.num_paths, adds_up=True),)

    def controls(self, nu: int) -> Mapping[str, int]:
        """A pace for each."""
        return {"paces": self.num_paths}

    @property
    def stage_parameters(self) -> Mapping[str, int]:
        """How much a pace counts in a step."""
        return {_ADVANCES: self.num_paths}

    @property
    def state_key(self) -> Mapping[str, Any]:
        """How many there are."""
        return {"num_paths": self.num_paths}

    def next_value(self, name: str, step: Passage) -> Any:
        """What was before, and e w."""
        return step.before[name] + progress_in_step(step)

    def idle_cost(self, at: StepSymbols) -> ca.SX:
        """Half the square of paces that nothing depends on."""
        return ca.dot(at.given[_ADVANCES] == 0, at.named_inputs["paces"] ** 2) / 2.0

    def stage_numbers(self, problem: Problem) -> Mapping[str, Array]:
        """Parameter e of every step and path."""
        return {_ADVANCES: advances(problem)}

    def control_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Forwards, and no leap."""
        steps = (advances(problem) > 0.0).sum(axis=0)[None]
        return {"paces": (np.full(steps.shape, _LEAST), np.clip(_MOST_OF_PATH * steps, _ROOM, _MOST))}

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Along which path."""
        return [f"progress along {constraint.name}" for constraint in _followers(problem)]

    def control_words(self, problem: Problem) -> Sequence[str]:
        """Of which path."""
        return [f"limit of the pace of {constraint.name}" for constraint in _followers(problem)]

    def controls_of(self, problem: Problem, motion: Motion) -> Mapping[str, Array]:
        """Paces that the configurations have."""
        e = advances(problem)
        progress_in_step = np.diff(progress_along(problem, motion.qs), axis=0)
        return {"paces": np.divide(progress_in_step, e, out=np.zeros_like(e), where=e > 0.0)}


def progress_in_step(step: Passage) -> Any:
    """Progress along each path in a step, e w."""
    return step.given[_ADVANCES] * step.controls["paces"]


def _followers(problem: Problem) -> tuple[PathConstraint, ...]:
    """The path constraints whose frames follow a path."""
    return tuple(c for c in problem.frame_constraints if c.follows)


def advances(problem: Problem) -> Array:
    """Parameter e of every step and path, shape (N, paths)."""
    columns = []
    for constraint in _followers(problem):
        on_path = constraint.span.nodes(problem.num_steps, problem.dt)
        if not constraint.span.has_start:
            on_path = on_path & np.append(False, on_path[:-1])  # the step to its first node leads to the path
        on_path = on_path & ~problem.timeline.is_impact
        columns.append(on_path / max(int(on_path.sum()), 1))
    return np.column_stack(columns) if columns else np.zeros((problem.num_steps, 0))


def progress_along(problem: Problem, qs: Array) -> Array:
    """How far frames are along their paths at the nodes of a motion, shape (N + 1, paths), from 0 to 1."""
    moves = np.vstack([np.zeros(len(_followers(problem))), advances(problem)]) > 0.0
    found = np.zeros(moves.shape)
    for k, constraint in enumerate(_followers(problem)):
        on_path = np.flatnonzero(moves[:, k])
        found[on_path, k] = constraint.progress(problem.robot, qs[on_path])
        found[on_path[-1] + 1 :, k] = found[on_path[-1], k]
    return found
