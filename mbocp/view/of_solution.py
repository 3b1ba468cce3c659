"""A solution as a replay: with its goals, via points, lines and obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

from mbocp.exceptions import ReplayError
from mbocp.robot.kinematics import WORLD
from mbocp.view.marks import marks_of_result
from mbocp.view.movie import Film, frame_times, pictures_of, write_frames, write_movie
from mbocp.view.replay import OtherMotion, open_replay, replay_page, write_replay

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from mbocp.problem import Problem
    from mbocp.robot import FrameTarget, Robot
    from mbocp.solution import Solution

_MAX_GHOSTS = 50


class Look(TypedDict, total=False):
    """What is shown of a solution, and from where.

    Attributes
    ----------
    robot : Robot, optional
        Default: the one of the solution, see `Solution.load_robot`.
    trace, direction
        As of `mbocp.view.replay.ReplayContent`.
    ghosts : int or sequence of float
        Times [s] at which the robot is drawn once more, faint; or how many, evenly spread from start to end.
    others : sequence of Solution
        Shown at the same time, each in a colour of its own; up to four.
    names : sequence of str
        What these are called; by default their problems' names.
    """

    robot: Robot | None
    trace: Sequence[str] | None
    ghosts: int | Sequence[float]
    others: Sequence[Solution]
    names: Sequence[str]
    direction: tuple[float, float] | None


def replay_solution(
    solution: Solution, path: str | Path | None = None, *, speed: float = 1.0, **look: Unpack[Look]
) -> Path | None:
    """Write the motion as a page, or show it in a browser.

    Parameters
    ----------
    solution : Solution
    path : str or Path, optional
        Page to write; without it the motion is shown live, until Ctrl-C.
    speed : float
        Seconds of motion per second of watching; 1 is true speed.
    **look
        What is shown, and from where: `Look`.

    Returns
    -------
    path : Path or None
        The page.

    Raises
    ------
    ReplayError, UnknownFrame
        As `mbocp.view.replay.write_replay`.
    """
    shown, drawn = _collect(solution, speed, **look)
    if path is None:
        open_replay(shown, solution.t, solution.qs, **drawn)
        return None
    return write_replay(shown, solution.t, solution.qs, path, **drawn)


def film_solution(
    solution: Solution,
    *,
    frames: str | Path | None = None,
    movie: str | Path | None = None,
    film: Film | None = None,
    **look: Unpack[Look],
) -> None:
    """Draw the motion as PNG pictures in a folder, or as a film; Chromium draws it.

    Parameters
    ----------
    solution : Solution
    frames : str or Path, optional
        Folder for the pictures.
    movie : str or Path, optional
        File .gif or .mp4; the latter needs ffmpeg.
    film : Film, optional
        Pictures a second, speed and size.
    **look
        What is shown, and from where: `Look`.

    Raises
    ------
    ReplayError
        As `replay_solution`; and if there is no Chromium or no ffmpeg.
    """
    how = film or Film()
    shown, drawn = _collect(solution, how.speed, **look)
    page = replay_page(shown, solution.t, solution.qs, **drawn)
    longest = max(float(each.t[-1] - each.t[0]) for each in (solution, *look.get("others", ())))
    pictures = pictures_of(page, frame_times(longest, how), how.size)
    if frames is not None:
        write_frames(pictures, frames)
    if movie is not None:
        write_movie(pictures, movie, how.frames_per_second)


def _collect(
    solution: Solution,
    speed: float,
    *,
    robot: Robot | None = None,
    trace: Sequence[str] | None = None,
    ghosts: int | Sequence[float] = 0,
    others: Sequence[Solution] = (),
    names: Sequence[str] = (),
    direction: tuple[float, float] | None = None,
) -> tuple[Robot, dict[str, Any]]:
    """The robot, and what a replay draws, as arguments of `write_replay`."""
    shown = solution.load_robot() if robot is None else robot
    for frame in trace or ():
        shown.frame_id(frame)
    times = _spread(solution, ghosts) if isinstance(ghosts, int) else ghosts
    called = names or [other.problem_name or f"motion {k}" for k, other in enumerate(others, 2)]
    beside = [
        OtherMotion(other.load_robot(), other.t, other.qs, name)
        for other, name in zip(others, called, strict=True)
    ]
    more = {"trace": trace, "speed": speed, "ghosts": times, "others": beside, "direction": direction}
    return shown, {**list_things_drawn(solution, shown), **more}


def _spread(solution: Solution, count: int) -> list[float]:
    """Times of so many ghosts; of one it is the end."""
    if not 0 <= count <= _MAX_GHOSTS:
        raise ReplayError(f"replay: ghosts: got {count}, expected from 0 to {_MAX_GHOSTS}")
    first, last = float(solution.t[0]), float(solution.t[-1])
    return [last] if count == 1 else [float(time) for time in np.linspace(first, last, count)]


def goals_of(problem: Problem, place: int | None) -> tuple[list[FrameTarget], list[FrameTarget]]:
    """Poses that the goal asks of frames, and those that the others ask, where there are several."""
    others = [goal for k, goal in enumerate(problem.goals) if k != place]
    ours = problem.member(place).goal
    return [pose.target for pose in ours.poses], [pose.target for goal in others for pose in goal.poses]


def list_things_drawn(solution: Solution, robot: Robot) -> dict[str, Any]:
    """What a replay of a solution draws besides the robot, as arguments of `write_replay`."""
    known, asked = {WORLD, *robot.frame_names}, solution.shown
    ours, others = ([], []) if asked is None else goals_of(asked.problem, solution.goal_place)
    return {
        "goals": [goal for goal in ours if {goal.name, goal.relative_to} <= known],
        "other_goals": [goal for goal in others if {goal.name, goal.relative_to} <= known],
        "marks": marks_of_result(solution, robot),
        "title": solution.problem_name or robot.name,
    }
