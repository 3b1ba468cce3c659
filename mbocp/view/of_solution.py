"""A solution as a replay: with its goals, via points, lines and obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbocp.robot.kinematics import WORLD
from mbocp.solution.problem_text import goal_targets_of, other_goal_targets_of
from mbocp.view.marks import marks_of_result
from mbocp.view.replay import open_replay, write_replay

if TYPE_CHECKING:
    from mbocp.robot import Robot
    from mbocp.solution import Solution

__all__ = ["drawn_of", "replay_solution"]


def replay_solution(
    solution: Solution,
    path: str | Path | None = None,
    *,
    robot: Robot | None = None,
    trace: Sequence[str] | None = None,
    speed: float = 1.0,
) -> Path | None:
    """Write the motion as a page, or show it in a browser.

    Parameters
    ----------
    solution : Solution
    path : str or Path, optional
        Page to write; without it the motion is shown live, until Ctrl-C.
    robot : Robot, optional
        Default: the one of the solution, see `Solution.load_robot`.
    trace, speed
        As of `mbocp.view.replay.write_replay`.

    Returns
    -------
    path : Path or None
        The page.

    Raises
    ------
    ReplayError, UnknownFrame
        As `mbocp.view.replay.write_replay`.
    """
    shown = solution.load_robot() if robot is None else robot
    for frame in trace or ():
        shown.frame_id(frame)
    drawn = {**drawn_of(solution, shown), "trace": trace, "speed": speed}
    if path is None:
        open_replay(shown, solution.t, solution.qs, **drawn)
        return None
    return write_replay(shown, solution.t, solution.qs, path, **drawn)


def drawn_of(solution: Solution, robot: Robot) -> dict[str, Any]:
    """What a replay of a solution draws besides the robot, as arguments of `write_replay`."""
    known = {WORLD, *robot.frame_names}
    text, place = solution.problem_text, solution.goal_place
    goals, others = (
        [goal for goal in found(text, place) if {goal.name, goal.relative_to} <= known]
        for found in (goal_targets_of, other_goal_targets_of)
    )
    return {
        "goals": goals,
        "other_goals": others,
        "marks": marks_of_result(solution, robot),
        "title": solution.problem_name or robot.name,
    }
