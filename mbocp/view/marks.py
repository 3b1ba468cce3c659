"""What a motion was to go through, for a replay: via points, lines and paths; obstacles, and forces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from mbocp._arrays import Array
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.robot.kinematics import WORLD
from mbocp.view.forces import ForceMark, forces_of

if TYPE_CHECKING:
    from mbocp.problem import Problem
    from mbocp.robot import Robot
    from mbocp.solution import Solution
    from mbocp.terms import FrameGoal


@dataclass(frozen=True, eq=False)
class ViaMark:
    """A pose of a frame on the way.

    Attributes
    ----------
    share : float
        Part of the motion's time that is over there.
    goal : FrameGoal
        Pose and tolerances.
    """

    share: float
    goal: FrameGoal


@dataclass(frozen=True, eq=False)
class Marks:
    """All that is drawn.

    Attributes
    ----------
    via : tuple of ViaMark
    lines : tuple of ndarray
        Points of each line and each path that is followed, shape (k, 3) [m].
    obstacles : tuple of Obstacle
    forces : tuple of ForceMark
    """

    via: tuple[ViaMark, ...] = ()
    lines: tuple[Array, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()
    forces: tuple[ForceMark, ...] = ()


def marks_of(problem: Problem) -> Marks:
    """Poses of frames at the via points of a problem, lines and paths of its path constraints, obstacles."""
    at = problem.timeline.times()
    shares = {point.via.name: float(at[point.node] / at[-1]) for point in problem.timeline.waypoints}
    return _marks(problem, shares)


def _marks(problem: Problem, shares: Mapping[str, float]) -> Marks:
    """What is drawn of a problem, with the via points of which it is known when they are passed."""
    via = (
        ViaMark(shares[point.via.name], frame)
        for point in problem.timeline.waypoints
        if point.via.name in shares
        for frame in point.via.goal.poses
    )
    lines = (constraint.term.draw(constraint) for constraint in problem.frame_constraints)
    drawn = tuple(points for points in lines if points is not None)
    return Marks(tuple(via), drawn, problem.obstacle)


def marks_of_result(solution: Solution, robot: Robot) -> Marks:
    """Return the same of a solution's problem, and its forces; frames that `robot` lacks are left out."""
    known, forces = {WORLD, *robot.frame_names}, forces_of(solution, robot)
    asked = solution.shown
    if asked is None:
        return Marks(forces=forces)
    whole = solution.duration or 1.0
    marks = _marks(asked.problem, {name: time / whole for name, time in solution.via_times.items()})
    via = (mark for mark in marks.via if {mark.goal.name, mark.goal.target.relative_to} <= known)
    obstacles = (obstacle for obstacle in asked.obstacles if obstacle.frame in known)
    return replace(marks, via=tuple(via), obstacles=tuple(obstacles), forces=forces)
