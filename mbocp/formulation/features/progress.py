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

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.features.switches import impacts_of
from mbocp.formulation.layout import StateLayout
from mbocp.problem import PathConstraint, Problem

__all__ = ["advances", "followed", "pace_bounds", "pace_names", "progress_along", "with_paces"]

_LEAST, _MOST = -1e-2, 8.0  # paces
_MOST_OF_PATH = 1.0 / 3.0  # in one step, where steps are few
_ROOM = 3.0  # times the mean pace, at least


def followed(problem: Problem) -> tuple[PathConstraint, ...]:
    """The path constraints whose frames follow a path."""
    return tuple(c for c in problem.frame_constraints if "progress" in c.term.remembers)


def advances(problem: Problem) -> Array:
    """Parameter e of every step and path, shape (N, paths)."""
    columns = []
    for constraint in followed(problem):
        on_path = constraint.span.nodes(problem.num_steps, problem.dt)
        if not constraint.span.has_start:
            on_path = on_path & np.append(False, on_path[:-1])  # the step to its first node leads to the path
        on_path = on_path & ~impacts_of(problem)
        columns.append(on_path / max(int(on_path.sum()), 1))
    return np.column_stack(columns) if columns else np.zeros((problem.num_steps, 0))


def progress_along(problem: Problem, qs: Array) -> Array:
    """How far frames are along their paths at the nodes of a motion, shape (N + 1, paths), from 0 to 1."""
    moves = np.vstack([np.zeros(len(followed(problem))), advances(problem)]) > 0.0
    found = np.zeros(moves.shape)
    for k, constraint in enumerate(followed(problem)):
        on_path = np.flatnonzero(moves[:, k])
        found[on_path, k] = constraint.progress(problem.robot, qs[on_path])
        found[on_path[-1] + 1 :, k] = found[on_path[-1], k]
    return found


def with_paces(problem: Problem, at: StateLayout, us: Array, qs: Array) -> Array:
    """Controls (N, nu) of the robot with the paces that configurations (N + 1, nq) have, on their right."""
    if not at.num_paces:
        return us
    e = advances(problem)
    gained = np.diff(progress_along(problem, qs), axis=0)
    return np.hstack([us, np.divide(gained, e, out=np.zeros_like(e), where=e > 0.0)])


def pace_bounds(problem: Problem) -> tuple[Array, Array]:
    """Lower and upper bounds of the paces, shapes (paths,)."""
    steps = (advances(problem) > 0.0).sum(axis=0)
    return np.full(len(steps), _LEAST), np.clip(_MOST_OF_PATH * steps, _ROOM, _MOST)


def pace_names(problem: Problem) -> tuple[str, ...]:
    """What paces are called."""
    return tuple(f"pace of {constraint.name}" for constraint in followed(problem))
