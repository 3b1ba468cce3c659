"""Limits and path constraints of a problem as bounds of its programme."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.exceptions import ProblemError
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.progress import pace_bounds
from mbocp.formulation.step_lengths import length_bounds
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import NaturalSpace
from mbocp.problem import ContactBounds, PathConstraint, Problem
from mbocp.programme import StateBounds

__all__ = ["free_speed_bounds", "path_nodes", "state_bounds"]


def state_bounds(
    problem: Problem,
    space: ConfigurationSpace | NaturalSpace,
    at: StateLayout,
    speeds: tuple[Array, Array],
) -> StateBounds:
    """Limits and path constraints of a problem in terms of its programme.

    Parameters
    ----------
    speeds : tuple of ndarray, shapes (ns,)
        Lower and upper bounds of the speeds.
    """
    limits, N = problem.limits, problem.num_steps
    lower, upper = np.full(at.nx, -np.inf), np.full(at.nx, np.inf)
    for part in space.parts:
        plain = part.at_q.stop - part.at_q.start if part.group.is_vector else 0
        plain = 3 if part.group.nv == 6 else 2 if (part.group.nz, part.group.nv) == (4, 3) else plain
        source = slice(part.at_q.start, part.at_q.start + plain)
        target = slice(part.at_z.start, part.at_z.start + plain)
        lower[target], upper[target] = limits.q_lower[source], limits.q_upper[source]
    lower[at.s], upper[at.s] = speeds
    free, paces = np.full(at.nh, np.inf), pace_bounds(problem)
    path_lower, path_upper = _path_bounds(problem)
    return StateBounds(
        x_lower=_of_states(lower, problem, at, ("h_lower", "t_lower")),
        x_upper=_of_states(upper, problem, at, ("h_upper", "t_upper")),
        u_lower=StateBounds.everywhere(np.concatenate([limits.u_lower, paces[0], -free]), N),
        u_upper=StateBounds.everywhere(np.concatenate([limits.u_upper, paces[1], free]), N),
        path_lower=path_lower,
        path_upper=path_upper,
    )


def _of_states(row: Array, problem: Problem, at: StateLayout, sides: tuple[str, str]) -> Array:
    """Bounds at all nodes, shape (N, nx); of lengths at the first nodes of phases, of times at their last."""
    rows = StateBounds.everywhere(row, problem.num_steps)
    if not at.nh:
        return rows
    rows, bounds = np.array(rows), length_bounds(problem)
    rows[:, at.h] = getattr(bounds, sides[0])[:, None]
    if at.nt:
        rows[:, at.t] = getattr(bounds, sides[1])[:, None]
    return rows


def _path_bounds(problem: Problem) -> tuple[Array, Array]:
    """Bounds of the path functions, shape (N, nh); infinite at the nodes where a constraint does not hold."""
    N = problem.num_steps
    sides = [constraint.inner_bounds for constraint in problem.inequalities]
    lower = np.concatenate([np.zeros(0), *(lower for lower, _ in sides)])
    upper = np.concatenate([np.zeros(0), *(upper for _, upper in sides)])
    holds = path_nodes(problem)
    if holds.all():
        return StateBounds.everywhere(lower, N), StateBounds.everywhere(upper, N)
    return np.where(holds, lower, -np.inf), np.where(holds, upper, np.inf)


def path_nodes(problem: Problem) -> BoolArray:
    """At which of the nodes 1..N each row of the path constraints holds, shape (N, nh)."""
    N, dt = problem.num_steps, problem.dt
    columns = [np.repeat(c.span.nodes(N, dt)[:, None], c.rows, axis=1) for c in problem.inequalities]
    for constraint, holds in zip(problem.inequalities, columns, strict=True):
        if isinstance(constraint, PathConstraint):
            holds[: np.flatnonzero(holds[:, 0])[-1], list(constraint.term.rows_at_end)] = False
        elif isinstance(constraint, ContactBounds) and constraint.source.acts is not None:
            holds[~constraint.source.acts] = False
    return np.hstack(columns) if columns else np.ones((N, 0), dtype=np.bool_)


def free_speed_bounds(problem: Problem) -> tuple[Array, Array]:
    """Bounds of the speeds where controls may prescribe some of the velocities.

    Raises
    ------
    ProblemError
        If a velocity is limited that is no unknown of the programme, because controls prescribe it.
    """
    robot, limits = problem.robot, problem.limits
    lower, upper = np.asarray(limits.v_lower), np.asarray(limits.v_upper)
    if not robot.drives:
        return lower, upper
    for i in robot.driven:
        if np.isfinite(lower[i]) or np.isfinite(upper[i]):
            raise ProblemError(
                f"limits.velocity: {robot.v_labels[i].name!r} is prescribed by a control; limit the control "
                "(limits.effort), and not its velocity"
            )
    free = [i for i in range(robot.nv) if i not in set(robot.driven)]
    unbounded = np.full(robot.num_speeds - len(free), np.inf)
    return np.concatenate([lower[free], -unbounded]), np.concatenate([upper[free], unbounded])
