r"""A start that is free, as one more control of the first step.

The state x_0 of the programme is given, and no solver has to know of more. The first step begins at

.. math:: x_0 \oplus e_k E w_k, \qquad e_0 = 1, \quad e_k = 0 \text{ in all other steps},

with the move w along the free directions E of (q, v). Where e is 0 nothing depends on w, and half its square
is added to the cost, which is zero at the optimum. The multiplier of w's row is the adjoint of the free
entries of the start: zero, unless bounds or the end say something of them (transversality). A start as a
further unknown of the recursion would save these idle controls; a control needs no other inertia check, no
other bounds and no other line search, in any solver.

Where the motion is periodic, states remember the move, :math:`r_{k+1} = r_k + e_k w_k`, so that the end
condition is a function of the last state alone. On groups r is in the tangent space of the given start.
"""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.formulation.goal import independent_rows
from mbocp.formulation.layout import StateLayout
from mbocp.lie import ConfigurationSpace
from mbocp.mechanisms.consistency import tangent_space
from mbocp.problem import Problem
from mbocp.problem.goals.free_start import kept_at_start, start_bounds
from mbocp.problem.goals.periodic import Periodic, impact_axes, numbers_of
from mbocp.problem.timeline.seam import compared
from mbocp.terms import KeptRows, PeriodicEnd, Sizes, StartEnd, StartState

__all__ = ["free_directions", "move_bounds", "move_names", "moved_start", "start_ends", "with_moves"]


def free_directions(problem: Problem) -> tuple[int, ...]:
    """Free directions of (q, v) at the start."""
    return problem.start_free.directions if problem.start_free is not None else ()


def move_names(problem: Problem) -> tuple[str, ...]:
    """What the moves are called."""
    robot = problem.robot
    names = [f"{part} of {label.name}" for part in ("position", "velocity") for label in robot.v_labels]
    return tuple(f"start {names[i]}" for i in free_directions(problem))


def with_moves(problem: Problem, at: StateLayout, us: Array, q: Array, v: Array) -> Array:
    """Controls (N, any) with the move from the given start to (q, v) on their right."""
    if not at.num_moves:
        return us
    robot = problem.robot
    away = np.concatenate([robot.difference(problem.q_start, q), v - problem.v_start])
    moves = np.zeros((len(us), at.num_moves))
    moves[0] = np.clip(away[list(at.moves)], *_sides(problem))
    return np.hstack([us, moves])


def moved_start(problem: Problem, at: StateLayout, us: Array) -> tuple[Array, Array]:
    """Configuration and velocity at which the motion of controls (N, any) starts."""
    robot, move = problem.robot, np.zeros(2 * problem.robot.nv)
    move[list(at.moves)] = us[0, at.of_moves(us.shape[1])]
    return robot.integrate(problem.q_start, move[: robot.nv]), problem.v_start + move[robot.nv :]


def move_bounds(problem: Problem, at: StateLayout) -> tuple[Array, Array]:
    """Lower and upper bounds of the moves in every step, shapes (N, moves); none after the first."""
    shape = (problem.num_steps, at.num_moves)
    lower, upper = np.full(shape, -np.inf), np.full(shape, np.inf)
    if at.num_moves:
        lower[0], upper[0] = _sides(problem)
    return lower, upper


def _sides(problem: Problem) -> tuple[Array, Array]:
    free = problem.start_free
    if free is None:
        return np.zeros(0), np.zeros(0)
    return start_bounds(problem.robot, problem.limits_of_ends[0], free, problem.q_start, problem.v_start)


def start_ends(problem: Problem, space: ConfigurationSpace) -> tuple[PeriodicEnd | StartEnd, ...]:
    """Conditions on the start: that the end is its image, and that it keeps the robot's constraints."""
    robot = problem.robot
    start = StartState(
        sizes=Sizes(space.nz, robot.nv, robot.nu, space.nz, robot.nv),
        free=free_directions(problem),
        z=space.coordinates(np.asarray(problem.q_start)[None])[0],
        v=np.asarray(problem.v_start),
    )
    found: list[PeriodicEnd | StartEnd] = []
    periodic = problem.goal.periodic
    if periodic is not None:
        found.append(_periodic_end(problem, periodic, space, start))
    kept = _kept(problem)
    if kept is not None:
        held = problem.switches.held if problem.switches is not None else ()
        found.append(StartEnd(start, *kept, held))
    return tuple(found)


def _kept(problem: Problem) -> tuple[KeptRows, KeptRows] | None:
    """Rows of the configuration and of the velocity that a free start has to keep."""
    free, periodic = problem.start_free, problem.goal.periodic
    if free is None:
        return None
    given = (problem.robot, free, problem.q_start, problem.v_start, problem.switches)
    places, rates = (_numbers(kept_at_start(*given, of_rates=of_rates)) for of_rates in (False, True))
    if periodic is not None and periodic.impact:  # then the image keeps the constraints' rates
        rates = KeptRows()
    return (places, rates) if places.count + rates.count else None


def _numbers(masks: tuple[BoolArray, BoolArray]) -> KeptRows:
    own, held = (tuple(int(i) for i in np.flatnonzero(mask)) for mask in masks)
    return KeptRows(own, held)


def _periodic_end(
    problem: Problem, periodic: Periodic, space: ConfigurationSpace, start: StartState
) -> PeriodicEnd:
    """The condition of a periodic motion.

    What constraints say of the end is no condition where the symmetry keeps them. An impact lets go what was
    held, so that constraints hold at both sides of it for other reasons, and all is compared.
    """
    robot, image = problem.robot, periodic.image(problem.robot)
    positions, velocities = _compared(problem, periodic)
    D_q = independent_rows(image.compared, positions, positions)
    D_v = independent_rows(np.ones(robot.nv, dtype=np.bool_), velocities, velocities)
    A_z, moved, places = np.eye(space.nz), np.zeros(space.nz), numbers_of(robot)
    at = {
        place: where for place, where in zip(places, _coordinates(space, robot.nv), strict=True) if place >= 0
    }
    rows = [int(i) for i in np.flatnonzero(places >= 0)]
    where = [at[int(places[i])] for i in rows]
    A_z[np.ix_(where, where)] = image.A[np.ix_(rows, rows)]
    moved[where] = image.moved[rows]
    axes = impact_axes(robot, periodic.impact) if periodic.impact else ()
    frame_id = robot.frame_names.index(periodic.impact) if periodic.impact else -1
    return PeriodicEnd(start, len(D_q), len(D_v), frame_id, axes, D_q, D_v, A_z, image.A, moved)


def _compared(problem: Problem, periodic: Periodic) -> tuple[Array, Array]:
    """Bases of the directions in which positions and velocities are compared, shapes (nv, any)."""
    robot, table = problem.robot, problem.switches
    if table is not None:
        ends = problem.q_start, problem.goal.q
        return compared(table, problem.start_free, periodic, ends)
    basis = np.eye(robot.nv) if periodic.impact else tangent_space(robot, problem.q_start)
    return basis, basis


def _coordinates(space: ConfigurationSpace, nv: int) -> list[int]:
    """Coordinate of each direction whose group is a vector space, else -1."""
    found = [-1] * nv
    for part in space.parts:
        if part.group.is_vector:
            for i in range(part.group.nz):
                found[part.at_v.start + i] = part.at_z.start + i
    return found
