"""What holds at both ends: the velocity of the first step, and exact end conditions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, dataclass, largest_entry, null_space, select_spanning_rows
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.exceptions import InconsistentStart
from mbocp.integrators import VELOCITY_TAU
from mbocp.lie import ConfigurationSpace
from mbocp.mechanisms.consistent_states import tangent_space
from mbocp.problem import Goal, Problem
from mbocp.problem.goals.frames import frame_projections
from mbocp.robot import Robot
from mbocp.robot.walking import find_walking_bodies
from mbocp.terms.frame_end import FrameEnd, FrameProjections

_ITERATIONS = 30  # Newton's method is quadratic: four are typical
_SMALL_STEP = 1e-12  # relative to the velocity: the next one would be round-off
_FAR = 10.0  # times the wanted velocity: no small correction of it any more


def consistent_velocity(problem: Problem) -> Array:
    r"""Velocity v_0 that fits the scheme, shape (nv,).

    It is the problem's, but for SE2 on a constrained system. There the first step moves to
    :math:`q_1 = q_0 \exp(\Delta t\,v_0)` before any force can act, and a tangential velocity leaves the
    constraint. So v_0 gets the smallest correction in the norm of the mass matrix,

    .. math:: v_0 \leftarrow v_0 - M^{-1} \Phi_q^T \nu \quad\text{with}\quad \Phi(q_1) = 0,

    which is of the order dt, normal to the constraint, and what every later step does with its own impulse.

    Raises
    ------
    InconsistentStart
        If no such velocity is near: the steps are too long for the start velocity. Or if start or length of
        the steps are free, so that there is none that fits before they are found.
    """
    robot, q, v = problem.robot, problem.q_start, problem.v_start
    if VELOCITY_TAU[problem.scheme] == 0.0 and robot.nc and problem.start_free is not None:
        raise InconsistentStart(
            f"start.free: scheme {problem.scheme} begins with a velocity that fits the constraints of robot "
            f"{robot.name!r} before it is found; take scheme se1 or midpoint, or give the start"
        )
    if VELOCITY_TAU[problem.scheme] == 0.0 and robot.nc and np.any(v):
        if problem.timeline.has_free_lengths:
            raise InconsistentStart(
                f"start.v: scheme {problem.scheme} begins with a velocity that fits the constraints of robot "
                f"{robot.name!r} and the length of a step, which horizon.duration or via.time leaves free; "
                "take scheme se1 or midpoint, or start at rest"
            )
        return _discrete_velocity(robot, q, v, float(problem.timeline.lengths()[0]))
    return v


def _discrete_velocity(robot: Robot, q: Array, wanted: Array, dt: float) -> Array:
    mass, push = robot.mass_matrix(q), robot.constraint_jacobian(q).T
    largest = _FAR * np.abs(wanted).max()
    v: Array = wanted
    nu = np.zeros(robot.nc)
    for _ in range(_ITERATIONS):
        q_next = robot.integrate(q, dt * v)
        residual = robot.constraint_residual(q_next)
        along = pin.dIntegrate(robot.model, q, dt * v, pin.ArgumentPosition.ARG1)
        dPhi_dv = robot.constraint_jacobian(q_next) @ along  # of Phi / dt, which is free of dt
        # One system for v and nu: the mass matrix may be singular where the constraints make up for it.
        matrix = np.block([[mass, push], [dPhi_dv, np.zeros((robot.nc, robot.nc))]])
        defect = np.concatenate([mass @ (wanted - v) - push @ nu, -residual / dt])
        step = np.linalg.lstsq(matrix, defect, rcond=None)[0]
        v, nu = v + step[: robot.nv], nu + step[robot.nv :]
        if np.abs(v).max() > largest:
            break
        if np.abs(step[: robot.nv]).max() <= _SMALL_STEP * largest:
            return v
    worst = robot.constraint_labels[int(np.argmax(np.abs(residual)))].name
    raise InconsistentStart(
        f"start.v: no velocity near it with which the first step of scheme se2, {dt:g} s, ends on the "
        f"constraint {worst!r} of robot {robot.name!r}; take more steps, or scheme se1 or midpoint"
    )


_RANK_TOLERANCE = (
    1e-9  # relative to the largest singular value: far above round-off, far below any real direction
)


@dataclass(frozen=True, eq=False)
class EndRows:
    """Projections of an exact end condition.

    Attributes
    ----------
    D_q : ndarray, shape (ng_q, nv)
        Acts on the tangent-space difference of q and q_d.
    D_rate : ndarray, shape (ng_rate, nv)
        Acts on p - p_d or v - v_d.
    frames : FrameProjections
        Act on the rows of goals of frames.
    """

    D_q: Array
    D_rate: Array
    frames: FrameProjections

    @property
    def of_joints(self) -> Array:
        """Both projections of the joints, one below the other."""
        return np.vstack([self.D_q, self.D_rate])

    def without(self, rows: Sequence[int]) -> EndRows:
        """Return the same less some rows of the joints, counted through both."""
        count = len(self.D_q)
        left_out = [r - count for r in rows if r >= count]
        return EndRows(
            np.delete(self.D_q, [r for r in rows if r < count], axis=0),
            np.delete(self.D_rate, left_out, axis=0),
            self.frames,
        )

    def words(self, robot: Robot, goal: Goal) -> tuple[str, ...]:
        """What each row is mostly about."""
        pairs = [("", self.D_q), ("rate of ", self.D_rate)]
        joints = (prefix + robot.v_labels[largest_entry(row)].name for prefix, D in pairs for row in D)
        return (*joints, *self.frames.labels(goal.conditions))


class EndTarget(NamedTuple):
    """Projections and values of an exact end condition in the programme's coordinates."""

    D_q: Array  # (ng_q, nv)
    D_rate: Array  # (ng_rate, nv)
    rate: Array  # (nv,) momentum or velocity


def end_condition_rows(
    robot: Robot,
    goal: Goal,
    speeds: Callable[[Array], Array] | None = None,
    *,
    ties: tuple[Array, Array] | None = None,
) -> EndRows:
    r"""Projections D_q, D_rate of the exact end condition, eq. (14).

    Eq. (14) as printed asks for all of p = p_d and is rank-deficient on a constrained system: the discrete
    steps already tie the last momentum to the constraint surface. Both parts are therefore projected onto
    the tangent space, by SVD for any constraint and any subset of conditions.

    With holds that begin or end on the way, and a goal that does not give every joint, `goal.q` is a guess of
    the configuration in which the motion ends. Conditions on rates are then entries of them: as many as the
    constraints leave free, those that say most of the others there, first of bodies that walk, and last of
    what robots carry: a load at rest leaves free what a stretched arm does, an arm at rest no load, and legs
    of which one is stretched the body. They say all wherever the constraints can be solved for the others,
    where a basis of the tangent space at the guess may be at right angles to velocities that the constraints
    allow. Where `goal.q` is the end of a motion, it is that basis.

    Parameters
    ----------
    robot : Robot
        Gives the constraint Jacobian and the mass matrix at the goal.
    goal : Goal
        Which components are enforced.
    speeds : callable, optional
        Configuration -> directions in which velocities can be, shape (nv, any), where these are fewer than
        the constraints allow.
    ties : tuple of ndarray, shapes (any, nv), optional
        Derivatives of what acts on positions and on velocities at the end, where it is not what the robot's
        constraints say.

    Returns
    -------
    EndRows
    """
    if not goal.is_exact:
        nothing = np.zeros((0, robot.nv))
        return EndRows(nothing, nothing, FrameProjections(nothing, nothing))
    basis = tangent_space(robot, goal.q) if ties is None else null_space(ties[0], RANK_TOLERANCE)
    free = basis if ties is None else null_space(ties[1], RANK_TOLERANCE)
    reachable = free if speeds is None else speeds(goal.q)
    moments = robot.mass_matrix(goal.q) @ reachable if goal.rate == "p" else reachable
    D_q = independent_rows(goal.q_active, basis, basis)
    if ties is None or goal.q_active.all() or goal.q_is_reached:
        D_rate = independent_rows(goal.rate_active, moments, reachable)
    else:
        D_rate = _choose_rates(robot, goal.rate_active, moments)
    to_rate = robot.mass_matrix(goal.q) if goal.rate == "p" else np.eye(robot.nv)
    frames = frame_projections(robot, goal, D_q, D_rate @ to_rate @ reachable, reachable, basis)
    return EndRows(D_q, D_rate, frames)


def _choose_rates(robot: Robot, active: BoolArray, moments: Array) -> Array:
    """Entries of rates that say all others: of bodies that walk, of robots, of loads, shape (rows, nv)."""
    chosen: list[int] = []
    left, walks = moments, find_walking_bodies(robot)
    for kind in (walks, ~(walks | robot.is_load), robot.is_load):
        entries = np.flatnonzero(active & kind)
        found = entries[select_spanning_rows(left[entries], RANK_TOLERANCE)]
        chosen += found.tolist()
        left = left @ null_space(left[found], RANK_TOLERANCE)
    return np.eye(robot.nv)[sorted(chosen)]


def acceleration_rows(problem: Problem) -> Array:
    """Independent rows on the accelerations that the goal asks for, shape (rows, nv)."""
    basis = problem.free_at_end(problem.goal.q)
    return independent_rows(problem.sets_acceleration, basis, basis)


def frame_ends(problem: Problem, rows: EndRows) -> tuple[FrameEnd, ...]:
    """Goals of frames as a term of the end: conditions, a cost, or both."""
    goal, robot = problem.goal, problem.robot
    if not goal.frames:
        return ()
    found = []
    if goal.is_penalised:
        found.append(FrameEnd.cost(goal.frames, robot, problem.cost.terminal))
    if goal.is_exact and goal.conditions:
        found.append(FrameEnd.conditions(goal.conditions, robot, rows.frames))
    return tuple(found)


def parts_to_guard(problem: Problem, space: ConfigurationSpace) -> tuple[int, ...]:
    """Parts of the configuration space whose projected end condition has other roots, and is to have none."""
    goal = problem.goal
    keeps_inequalities = problem.is_bounded or problem.solver.is_interior_point
    if not (goal.is_exact and goal.guard and keeps_inequalities):
        return ()
    z = ca.SX.sym("z", space.nz)
    return tuple(
        i
        for i, part in enumerate(space.parts)
        if part.group.guards(z[part.at_z], z[part.at_z]) and goal.q_active[part.at_v].all()
    )


def independent_rows(active: BoolArray, reachable: Array, basis: Array) -> Array:
    """Independent rows among the `active` ones, given the `reachable` directions."""
    if not active.any():
        return np.zeros((0, active.size))
    if active.all() and basis.shape[0] == reachable.shape[0]:  # the paper's P' (y - y_d)
        return np.ascontiguousarray(basis.T)
    selection = np.eye(active.size)[active]
    left, values, _ = np.linalg.svd(selection @ reachable, full_matrices=False)
    rank = int(np.sum(values > _RANK_TOLERANCE * max(values[0], 1e-300)))
    if rank == selection.shape[0]:
        return selection
    return np.ascontiguousarray(left[:, :rank].T @ selection)
