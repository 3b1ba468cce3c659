"""Parts of guesses: ways along lines and paths of frames, and controls that balance a motion."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import TypeVar

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.guesses.ways import Way, position_limits, straight, straight_to
from mbocp.mechanisms.closed_path import constraint_jacobians
from mbocp.problem import PathConstraint, Problem
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.programme.compiler import check_deadline
from mbocp.robot import Robot
from mbocp.robot.kinematics import difference
from mbocp.robot.large import make_working_data
from mbocp.robot.mechanism import Mechanism
from mbocp.robot.poses.pose_rows import PoseRows
from mbocp.robot.poses.pose_search import joint_bounds, reach
from mbocp.robot.poses.target import FrameTarget
from mbocp.terms.kinds import FrameVelocity

_TOLERANCE = 1e-9  # [m, rad]
_LEAP, _FACTOR = 0.5, 4.0  # [rad, m] beyond so many times the step of what is near: another branch


def usual_way(problem: Problem) -> Way:
    """Along the lines and paths that frames keep to all the time; without any, straight to the goal."""
    kept = _find_kept_constraints(problem)
    if not is_led(problem):
        return straight(problem)

    def way(q_start: Array, shares: Array) -> Array:
        found = _along(problem, kept, q_start, shares)
        return straight(problem)(q_start, shares) if found is None else found

    return way


def is_led(problem: Problem) -> bool:
    """Whether a frame keeps to a line or a path all the time, which leads it to its goal."""
    return any(c.term.leads for c in _find_kept_constraints(problem))


def follows_path(problem: Problem) -> bool:
    """Whether a frame follows a path all the time, so that the whole way is known without a goal."""
    return any("progress" in c.term.remembers for c in _find_kept_constraints(problem))


def _find_kept_constraints(problem: Problem) -> list[PathConstraint]:
    """What frames keep to all the time; of those that roll the first, which the others follow."""
    N, dt = problem.num_steps, problem.dt
    kept = [c for c in problem.frame_constraints if c.span.has_start and c.span.has_end(N, dt)]
    roll = [c for c in kept if isinstance(c.term, FrameVelocity) and c.term.rolls]
    return [c for c in kept if c not in roll[1:]]


def _along(problem: Problem, kept: Sequence[PathConstraint], q_start: Array, shares: Array) -> Array | None:
    """Configurations in which frames are where they are to be, near the straight line to a goal like that."""
    robot, goal, limits = problem.robot, problem.goal, position_limits(problem)
    names = [robot.frame_names[c.frame] for c in kept]
    starts, goals = ([robot.frame_placement(name, q) for name in names] for q in (q_start, goal.q))

    def targets(share: float) -> list[FrameTarget]:
        asked = zip(kept, names, starts, goals, strict=True)
        found = (c.term.target(c, name, (start, end), share) for c, name, start, end in asked)
        return [target for target in found if target is not None]

    ends = {0.0: q_start}
    if goal.q_active.all():
        ends[1.0] = goal.q
    elif goal.poses:
        reached = along_poses(robot, [targets(1.0)], goal.q[None], limits)
        if reached is None:
            return None
        ends[1.0] = reached[0]
    has_end = 1.0 in ends
    near = straight_to(problem, ends[1.0])(q_start, shares) if has_end else np.tile(q_start, (len(shares), 1))
    found = along_poses(robot, [targets(share) for share in shares], near, limits)
    if found is not None:
        for share, q in ends.items():
            found[shares == share] = q
    return found


def along_poses(
    robot: Mechanism, poses: Sequence[Sequence[FrameTarget]], near: Array, limits: tuple[Array, Array]
) -> Array | None:
    """Configurations that reach one set of targets after the other.

    Parameters
    ----------
    robot : Mechanism
    poses : sequence of sequence of FrameTarget
        Targets of each configuration.
    near : ndarray, shape (n, nq)
        A continuous way, whose branch the configurations have.
    limits : tuple of ndarray, shapes (nq,)
        Lower and upper positions that they keep [rad, m].

    Returns
    -------
    qs : ndarray, shape (n, nq), or None
        None if one is out of reach from there, or they leap from one branch to another.
    """
    bounds = joint_bounds(robot.model, *limits, frozenset())
    held = np.zeros(robot.model.nv, dtype=np.bool_)
    found, aside = np.empty_like(near), np.zeros(robot.model.nv)
    for n, targets in enumerate(poses):
        first = bounds.clip(pin.integrate(robot.model, near[n], aside))
        q, has_arrived = reach(PoseRows(robot, targets), first, bounds, held, _TOLERANCE)
        if not has_arrived:
            return None
        found[n], aside = q, difference(robot.model, near[n], q)
    return None if _leaps(robot.model, found, near) else found


def _leaps(model: pin.Model, qs: Array, near: Array) -> bool:
    steps, usual = (
        np.array([np.abs(difference(model, a, b)).max() for a, b in pairwise(way)]) for way in (qs, near)
    )
    return bool((steps > _LEAP + _FACTOR * usual).any())


_T = TypeVar("_T")


def compute_required_force(robot: Robot, q: Array, v: Array, a: Array) -> Array:
    """Generalised force that actuators and constraints have to supply for a motion, shape (nv,)."""
    force: Array = pin.rnea(robot.model, make_working_data(robot.model), q, v, a)
    return force - robot.force_elements(q, v) if robot.has_forces else force


def balances(
    robot: Robot,
    qs: Array,
    vs: Array,
    accelerations: Array,
    table: SwitchTable | None = None,
    deadline: float = math.inf,
) -> tuple[Array, Array]:
    """Controls and multipliers that balance the inverse dynamics best along a motion.

    With a table the multipliers of what is held follow those of the robot; those of impacts are zero.

    Raises
    ------
    CompilationTimeout
        If the deadline, a time of `time.perf_counter`, passes.
    """
    motion: Iterable[tuple[Array, Array, Array]] = zip(qs, vs, accelerations, strict=True)
    if deadline < math.inf:
        motion = _in_time(motion, deadline)
    if table is not None or robot.nc or robot.has_forces or robot.actuation.frame_actuators:
        rows = constraint_jacobians(robot, qs)
        if table is not None:
            rows = table.along(qs, rows) * ~table.is_impact[:, None, None]
        forces = np.array([compute_required_force(robot, *at) for at in motion])
        if robot.actuation.is_constant:
            columns = np.broadcast_to(robot.actuation_matrix(qs[0]), (len(qs), robot.nv, robot.nu))
        else:
            columns = np.array([robot.actuation_matrix(q) for q in qs])
        columns = np.concatenate([columns, -rows.transpose(0, 2, 1)], axis=2)
        inverses = np.linalg.pinv(columns, rcond=np.finfo(float).eps * max(columns.shape[1:]))
        found: Array = np.einsum("nij,nj->ni", inverses, forces)
        return found[:, : robot.nu], found[:, robot.nu :]
    data, columns = make_working_data(robot.model), robot.actuation_matrix(qs[0])  # the same everywhere
    forces = np.array([pin.rnea(robot.model, data, *at).copy() for at in motion])
    us: Array = np.linalg.lstsq(columns, forces.T, rcond=None)[0].T
    return np.ascontiguousarray(us), np.zeros((len(qs), 0))


def _in_time(values: Iterable[_T], deadline: float) -> Iterator[_T]:
    """Values one by one, while there is time: long horizons have many."""
    for value in values:
        check_deadline(deadline, "the guess was made")
        yield value


def balance(robot: Robot, q: Array, v: Array, a: Array, dPhi_dq: Array) -> tuple[Array, Array]:
    """Controls and multipliers that balance the inverse dynamics best, in the least-squares sense."""
    columns = np.hstack([robot.actuation_matrix(q), -dPhi_dq.T])
    found = np.linalg.lstsq(columns, compute_required_force(robot, q, v, a), rcond=None)[0]
    return found[: robot.nu], found[robot.nu :]
