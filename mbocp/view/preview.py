"""A problem before it is solved, as a page: the start, the goal as a ghost, via points, obstacles, lines."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array
from mbocp.solution.atomic import replace_text
from mbocp.view.marks import marks_of
from mbocp.view.meshcat.page import render_page
from mbocp.view.meshcat.scene import build_scene
from mbocp.view.motion_samples import sample_motion

if TYPE_CHECKING:
    from mbocp.problem import Problem

_MAX_GHOSTS = 6


def write_preview(problem: Problem, path: str | Path) -> Path:
    """Write the page.

    Parameters
    ----------
    problem : Problem
    path : str or Path
        The file; an old one is replaced only when the new one is complete.

    Raises
    ------
    ResultFileError
        If the file cannot be written.
    """
    robot = problem.robot
    ghosts = [sample_motion(robot.model, [0.0], [q]) for q in _ghost_poses(problem)[:_MAX_GHOSTS]]
    goals = [frame.target for _, member in problem.members for frame in member.goal.poses]
    scene = build_scene(
        robot,
        sample_motion(robot.model, [0.0], [problem.q_start]),
        trace=(),
        goals=goals,
        marks=marks_of(problem),
        ghosts=ghosts,
    )
    subtitle = f"{robot.name} · start, and the goal as a ghost" if ghosts else f"{robot.name} · start"
    page = render_page(scene, title=problem.name, subtitle=subtitle, speed=1.0)
    return replace_text(path, page)


def _ghost_poses(problem: Problem) -> list[Array]:
    """Configurations that the motion is to reach, other than the start."""
    asked = [member.goal for _, member in problem.members if member.goal.says_where]
    asked += [point.via.goal for point in problem.timeline.waypoints if point.via.goal.says_where]
    start = problem.q_start
    return [np.array(goal.q) for goal in asked if not np.allclose(goal.q, start)]
