"""Replays: a motion as one HTML file that works offline, or as a live page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mbocp.exceptions import MbocpError, ReplayError
from mbocp.solution.atomic import replace_file
from mbocp.view.marks import Marks
from mbocp.view.meshcat.live import LiveReplay, ends_gently
from mbocp.view.meshcat.page import Below, render_page
from mbocp.view.meshcat.scene import Scene, build_scene
from mbocp.view.motion import Motion, sample_motion

if TYPE_CHECKING:
    from mbocp.robot import FrameTarget, LinkSpheres, Robot

__all__ = ["open_replay", "replay_page", "write_replay"]


def write_replay(
    robot: Robot,
    t: ArrayLike,
    qs: ArrayLike,
    path: str | Path,
    *,
    trace: Sequence[str] | None = None,
    goals: Sequence[FrameTarget] = (),
    other_goals: Sequence[FrameTarget] = (),
    marks: Marks | None = None,
    spheres: Sequence[LinkSpheres] = (),
    title: str = "",
    speed: float = 1.0,
    samples_per_second: float = 60.0,
) -> Path:
    """Write a motion as one self-contained HTML file: robot, meshes, animation, viewer.

    Parameters
    ----------
    robot : Robot
        The robot; what has no mesh is drawn as sticks.
    t : array_like, shape (N + 1,)
        Times [s].
    qs : array_like, shape (N + 1, nq)
        Configurations [m, rad, unit quaternion xyzw].
    path : str or Path
        The file; an old one is replaced only when the new one is complete.
    trace : sequence of str, optional
        Frames whose path is drawn; by default `robot.trace_frames`.
    goals : sequence of FrameTarget
        Poses of frames whose axes are drawn: where the motion was to end.
    other_goals : sequence of FrameTarget
        Faint ones: where it might have ended, too.
    marks : Marks, optional
        Via points, lines and obstacles, see `mbocp.view.marks.marks_of`.
    spheres : sequence of LinkSpheres
        Spheres to draw over the robot, see `Robot.collision_spheres`.
    title : str
        Shown above the picture; by default the robot's name.
    speed : float
        Seconds of motion per second of watching; 1 is true speed.
    samples_per_second : float
        Key frames per second of watching [1/s].

    Returns
    -------
    path : Path
        The file.

    Raises
    ------
    ReplayError
        If the motion does not fit the robot, or the file cannot be written.
    UnknownFrame
        If a traced frame does not exist.
    """
    page = replay_page(
        robot,
        t,
        qs,
        trace=trace,
        goals=goals,
        other_goals=other_goals,
        marks=marks,
        spheres=spheres,
        title=title,
        speed=speed,
        samples_per_second=samples_per_second,
    )
    try:
        return replace_file(path, page.encode("utf-8", errors="replace"))  # names of files may be no text
    except MbocpError as error:
        raise ReplayError(f"replay {error}") from error


def replay_page(
    robot: Robot,
    t: ArrayLike,
    qs: ArrayLike,
    *,
    trace: Sequence[str] | None = None,
    goals: Sequence[FrameTarget] = (),
    other_goals: Sequence[FrameTarget] = (),
    marks: Marks | None = None,
    spheres: Sequence[LinkSpheres] = (),
    title: str = "",
    speed: float = 1.0,
    samples_per_second: float = 60.0,
    below: Below | None = None,
) -> str:
    """The page that `write_replay` writes, as text; `below` is what stands under the picture."""
    motion = _motion(robot, t, qs, speed, samples_per_second)
    scene = build_scene(
        robot, motion, trace=trace, goals=goals, other_goals=other_goals, marks=marks, spheres=spheres
    )
    return render_page(
        scene,
        title=title or robot.name,
        subtitle=_subtitle(robot, motion, title),
        speed=speed,
        below=below,
    )


def open_replay(
    robot: Robot,
    t: ArrayLike,
    qs: ArrayLike,
    *,
    trace: Sequence[str] | None = None,
    goals: Sequence[FrameTarget] = (),
    other_goals: Sequence[FrameTarget] = (),
    marks: Marks | None = None,
    title: str = "",
    speed: float = 1.0,
    samples_per_second: float = 60.0,
    browser: bool = True,
) -> None:
    """Show a motion on a live meshcat page until Ctrl-C; arguments as in `write_replay`.

    The page is served on this machine only. It opens in the browser if there is one, its address is printed
    anyway, and the scene is sent once a browser has connected.

    Parameters
    ----------
    browser : bool
        Whether to open a browser window.

    Raises
    ------
    ReplayError
        If the motion does not fit the robot, or the page cannot be served.
    UnknownFrame
        If a traced frame does not exist.
    """
    motion = _motion(robot, t, qs, speed, samples_per_second)
    scene = build_scene(
        robot, motion, trace=trace, goals=goals, other_goals=other_goals, marks=marks, speed=speed
    )
    serve(scene, title=title or robot.name, browser=browser)


def serve(scene: Scene, *, title: str, browser: bool) -> None:
    """Serve a scene until Ctrl-C."""
    with ends_gently(), LiveReplay() as live:
        print(f"{title}: open {live.url} in a browser (Ctrl-C ends the replay)", flush=True)
        try:
            if browser:
                live.open_browser()
            live.wait_for_browser()
            live.send(scene)
            print("Playing.", flush=True)
            live.wait_until_closed()
        except KeyboardInterrupt:
            print("\nReplay closed.", flush=True)


def _motion(robot: Robot, t: ArrayLike, qs: ArrayLike, speed: float, samples_per_second: float) -> Motion:
    for name, value in (("speed", speed), ("samples_per_second", samples_per_second)):
        if not (np.isfinite(value) and value > 0.0):
            raise ReplayError(f"replay: {name}: got {value}, expected a positive number")
    try:
        return sample_motion(robot.model, t, qs, samples_per_second / speed)
    except (MbocpError, ValueError) as error:
        raise ReplayError(f"replay of {robot.name!r}: {error}") from error


def _subtitle(robot: Robot, motion: Motion, title: str) -> str:
    shown = f"{motion.duration:.3g} s" if motion.duration > 0.0 else "one pose"
    return f"{robot.name} · {shown}" if title and title != robot.name else shown
