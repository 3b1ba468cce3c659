"""The way of a guess along lines and paths that frames are to keep to, by inverse kinematics."""

from __future__ import annotations

from collections.abc import Sequence

from mbocp._arrays import Array
from mbocp.guesses.ways import Way, position_limits, straight, straight_to
from mbocp.problem import PathConstraint, Problem
from mbocp.robot import FrameTarget
from mbocp.robot.poses.along import along_poses

__all__ = ["usual_way"]


def usual_way(problem: Problem) -> Way:
    """Along the lines and paths that frames keep to all the time; without any, straight to the goal."""
    N, dt = problem.num_steps, problem.dt
    kept = [c for c in problem.frame_constraints if c.span.has_start and c.span.has_end(N, dt)]
    if not any(c.term.leads for c in kept):
        return straight(problem)

    def way(q_start: Array, shares: Array) -> Array:
        found = _along(problem, kept, q_start, shares)
        return straight(problem)(q_start, shares) if found is None else found

    return way


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

    q_end = goal.q
    if not goal.q_active.all():
        reached = along_poses(robot, [targets(1.0)], q_end[None], limits)
        if reached is None:
            return None
        q_end = reached[0]
    near = straight_to(problem, q_end)(q_start, shares)
    found = along_poses(robot, [targets(share) for share in shares], near, limits)
    if found is not None:
        found[shares == 0.0], found[shares == 1.0] = q_start, q_end
    return found
