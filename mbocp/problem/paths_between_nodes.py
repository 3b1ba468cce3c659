"""Path constraints between nodes: which are looked at there, and which hold within steps, too.

The tool's place and speed there follow from the cubics of the joints, whose rows of other kinds have means of
their own, see `mbocp.problem.speed_lines` and `mbocp.terms.braking`. Equations on places are none of them:
steps that keep them at both ends leave them by what they are wrong by.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp._tolerances import PATH_TOLERANCE_PART, PATH_TOLERANCES
from mbocp.integrators import SCHEMES
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.path import PathConstraint
from mbocp.terms.kinds import PATH_TERMS, Braking
from mbocp.terms.over_speed import OverSpeed

if TYPE_CHECKING:
    from mbocp.problem.problem import Problem

_ELSEWHERE = (OverSpeed, Braking)
LEAST_SIZE = 1e-9  # of a limit
_ROOM = 0.5  # of what rows may be left by between nodes: solvers get it within steps


def paths_within(problem: Problem) -> tuple[PathConstraint, ...]:
    """Path constraints with rows that are looked at between nodes."""
    return tuple(
        path
        for path in problem.frame_constraints
        if not issubclass(PATH_TERMS[path.kind], _ELSEWHERE)
        and set(path.term.remembers) <= {"progress"}
        and _is_limit(path).any()
    )


def can_hold_paths_within(problem: Problem) -> bool:
    """Whether there are some, and rows within steps can keep them."""
    scheme = SCHEMES[problem.scheme]
    is_known = (
        scheme.order > 1 and scheme.solves_constraints and COORDINATES[problem.coordinates].has_joint_states
    )
    is_plain = problem.robust is None and not problem.robot.drives
    return is_known and is_plain and bool(paths_within(problem))


def rows_within(path: PathConstraint, problem: Problem) -> BoolArray:
    """In which steps each of its rows is looked at: those at both of whose ends it holds, shape (N, rows)."""
    start = np.full((1, path.rows), path.span.has_start)
    at_nodes = np.vstack([start, path.nodes(problem.num_steps, problem.dt)])
    return at_nodes[:-1] & at_nodes[1:] & ~problem.timeline.is_impact[:, None] & _is_limit(path)


def sides_within(path: PathConstraint) -> tuple[Array, Array]:
    """Bounds of the expression within steps, shapes (rows,)."""
    room = _ROOM * tolerances_within(path) * _sizes(path)
    return path.term.inner((path.lower - room, path.upper + room))


def tolerances_within(path: PathConstraint) -> Array:
    """By which part of its larger bound each row may be left between nodes, shape (rows,)."""
    units = [label.unit for label in path.labels]
    plain = np.array([PATH_TOLERANCES.get(unit, np.nan) for unit in units])
    return np.where(np.isnan(plain), PATH_TOLERANCE_PART, plain / _sizes(path))


def _sizes(path: PathConstraint) -> Array:
    sides = [np.where(np.isfinite(side), np.abs(side), 0.0) for side in (path.lower, path.upper)]
    return np.maximum(np.max(sides, axis=0), LEAST_SIZE)


def _is_limit(path: PathConstraint) -> BoolArray:
    """Which rows are no equations, or those of a speed; zero has no part that it may be left by."""
    return (path.lower < path.upper) | (path.term.has_velocity & (_sizes(path) > LEAST_SIZE))
