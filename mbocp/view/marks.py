"""What a motion was to go through, for a replay: via points, lines and paths; obstacles, and forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbocp._arrays import Array
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.robot.kinematics import WORLD
from mbocp.solution.problem_text import lines_of, obstacles_of, via_goals_of
from mbocp.view.forces import ForceMark, forces_of

if TYPE_CHECKING:
    from mbocp.problem import Problem
    from mbocp.robot import Robot
    from mbocp.solution import Solution
    from mbocp.terms import FrameGoal

__all__ = ["Marks", "ViaMark", "marks_of", "marks_of_result"]


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


def marks_of(problem: Problem, times: Array | None = None) -> Marks:
    """Poses of frames at the via points of a problem, lines and paths of its path constraints, obstacles.

    Parameters
    ----------
    problem : Problem
    times : ndarray, shape (N + 1,), optional
        Of the nodes of a motion [s]; default: those of the problem, or their guess.
    """
    from mbocp.problem.timeline.phases import node_times  # slow to import, and of no use to a result

    at = node_times(problem) if times is None else times
    via = (
        ViaMark(float(at[point.node] / at[-1]), frame)
        for point in problem.waypoints
        for frame in point.via.goal.poses
    )
    lines = (constraint.term.drawn(constraint) for constraint in problem.frame_constraints)
    drawn = tuple(points for points in lines if points is not None)
    return Marks(tuple(via), drawn, problem.obstacle)


def marks_of_result(solution: Solution, robot: Robot) -> Marks:
    """The same from the text of the problem that a result holds; frames that the robot lacks are left out."""
    t, known = solution.t - solution.t[0], {WORLD, *robot.frame_names}
    via = [
        ViaMark(float(t[min(node, solution.num_steps)] / t[-1]) if t[-1] > 0.0 else 0.0, goal)
        for node, goal in via_goals_of(solution.problem_text)
        if {goal.name, goal.target.relative_to} <= known
    ]
    obstacles = (o for o in obstacles_of(solution.problem_text) if o.frame in known)
    forces = forces_of(solution, robot)
    return Marks(tuple(via), lines_of(solution.problem_text), tuple(obstacles), forces)
