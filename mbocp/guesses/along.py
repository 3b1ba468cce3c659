"""The way of a guess along lines and paths that frames are to keep to, by inverse kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.guesses.ways import Way, position_limits, straight, straight_to
from mbocp.problem import PathConstraint, Problem
from mbocp.robot.kinematics import difference
from mbocp.robot.mechanism import Mechanism
from mbocp.robot.poses.pose_rows import PoseRows
from mbocp.robot.poses.pose_search import joint_bounds, reach
from mbocp.robot.poses.target import FrameTarget

_TOLERANCE = 1e-9  # [m, rad]
_LEAP, _FACTOR = 0.5, 4.0  # [rad, m] beyond so many times the step of what is near: another branch


def usual_way(problem: Problem) -> Way:
    """Along the lines and paths that frames keep to all the time; without any, straight to the goal."""
    kept = _kept_constraints(problem)
    if not is_led(problem):
        return straight(problem)

    def way(q_start: Array, shares: Array) -> Array:
        found = _along(problem, kept, q_start, shares)
        return straight(problem)(q_start, shares) if found is None else found

    return way


def is_led(problem: Problem) -> bool:
    """Whether a frame keeps to a line or a path all the time, which leads it to its goal."""
    return any(c.term.leads for c in _kept_constraints(problem))


def follows_path(problem: Problem) -> bool:
    """Whether a frame follows a path all the time, so that the whole way is known without a goal."""
    return any("progress" in c.term.remembers for c in _kept_constraints(problem))


def _kept_constraints(problem: Problem) -> list[PathConstraint]:
    """What frames keep to all the time."""
    N, dt = problem.num_steps, problem.dt
    return [c for c in problem.frame_constraints if c.span.has_start and c.span.has_end(N, dt)]


def _along(problem: Problem, kept: Sequence[PathConstraint], q_start: Array, shares: Array) -> Array | None:
    """Configurations in which frames are where they are to be, near the straight line to a goal like that."""
    robot, goal, limits = problem.robot, problem.goal, position_limits(problem)
    names = [robot.frame_names[c.frame] for c in kept]
    starts, goals = (
        [robot.frame_placement(name, q).translation for name in names] for q in (q_start, goal.q)
    )

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
