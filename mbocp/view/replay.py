"""Replays: a motion as one HTML file that works offline, or as a live page."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from mbocp._arrays import dataclass
from mbocp._processes import signal_handler
from mbocp.exceptions import MbocpError, ReplayError
from mbocp.solution.atomic import replace_text
from mbocp.view.live_robot import LiveReplay
from mbocp.view.marks import Marks
from mbocp.view.meshcat.ghosts import COLOURS, Other
from mbocp.view.meshcat.page import Below, render_page
from mbocp.view.meshcat.scene import Scene, build_scene
from mbocp.view.motion_samples import PlacementSamples, pose_at, sample_motion

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from mbocp.robot import FrameTarget, LinkSpheres, Robot

_STEEPEST = 89.0  # [deg]; from straight above there is no upright


@dataclass(frozen=True)
class OtherMotion:
    """A motion that is shown beside the first.

    Attributes
    ----------
    robot : Robot
    t : array_like, shape (N + 1,)
        Times [s].
    qs : array_like, shape (N + 1, nq)
        Configurations [m, rad, unit quaternion xyzw].
    name : str
    """

    robot: Robot
    t: ArrayLike
    qs: ArrayLike
    name: str


class ReplayItems(TypedDict, total=False):
    """What a replay shows with the robot.

    Attributes
    ----------
    trace : sequence of str, optional
        Frames whose path is drawn; by default `robot.trace_frames`.
    goals, other_goals : sequence of FrameTarget
        Poses of frames whose axes are drawn: where the motion was to end; faint, where else it might have.
    marks : Marks, optional
        Via points, lines and obstacles, see `mbocp.view.marks.marks_of`.
    spheres : sequence of LinkSpheres
        Spheres to draw over the robot, see `Robot.collision_spheres`.
    """

    trace: Sequence[str] | None
    goals: Sequence[FrameTarget]
    other_goals: Sequence[FrameTarget]
    marks: Marks | None
    spheres: Sequence[LinkSpheres]


class ReplayContent(ReplayItems, total=False):
    """What a replay shows, and how.

    Attributes
    ----------
    ghosts : sequence of float
        Times [s], as those of the motion, at which the robot is drawn once more, faint.
    others : sequence of OtherMotion
        Motions that are shown at the same time, each in a colour of its own; up to four.
    direction : (float, float), optional
        Azimuth and elevation [deg] from which the camera looks; by default where most can be seen.
    title : str
        Shown above the picture; by default the robot's name.
    speed : float
        Seconds of motion per second of watching; 1 is true speed.
    samples_per_second : float
        Key frames per second of watching [1/s].
    """

    ghosts: Sequence[float]
    others: Sequence[OtherMotion]
    direction: tuple[float, float] | None
    title: str
    speed: float
    samples_per_second: float


def write_replay(
    robot: Robot, t: ArrayLike, qs: ArrayLike, path: str | Path, **drawn: Unpack[ReplayContent]
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
    **drawn
        What is shown, and how: `mbocp.view.replay.ReplayItems` and `ReplayContent`.

    Returns
    -------
    path : Path
        The file.

    Raises
    ------
    ReplayError
        If the motion does not fit the robot.
    ResultFileError
        If the file cannot be written.
    UnknownFrame
        If a traced frame does not exist.
    """
    return replace_text(path, replay_page(robot, t, qs, **drawn))


def replay_page(
    robot: Robot, t: ArrayLike, qs: ArrayLike, *, below: Below | None = None, **drawn: Unpack[ReplayContent]
) -> str:
    """The page that `write_replay` writes, as text; `below` is what stands under the picture."""
    scene, title, subtitle = _compose(robot, t, qs, **drawn)
    return render_page(scene, title=title, subtitle=subtitle, speed=drawn.get("speed", 1.0), below=below)


def open_replay(
    robot: Robot, t: ArrayLike, qs: ArrayLike, *, browser: bool = True, **drawn: Unpack[ReplayContent]
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
    scene, title, _ = _compose(robot, t, qs, is_live=True, **drawn)
    serve(scene, title=title, browser=browser)


def _compose(
    robot: Robot,
    t: ArrayLike,
    qs: ArrayLike,
    *,
    is_live: bool = False,
    ghosts: Sequence[float] = (),
    others: Sequence[OtherMotion] = (),
    direction: tuple[float, float] | None = None,
    title: str = "",
    speed: float = 1.0,
    samples_per_second: float = 60.0,
    **shown: Unpack[ReplayItems],
) -> tuple[Scene, str, str]:
    """The scene, title and subtitle of a replay; a live one has its speed in the scene."""
    motion = _motion(robot, t, qs, speed, samples_per_second)
    beside = _others(others, speed, samples_per_second)
    scene = build_scene(
        robot,
        motion,
        ghosts=_ghosts(robot, t, qs, ghosts),
        others=beside,
        speed=speed if is_live else 1.0,
        direction=_direction(direction),
        **shown,
    )
    return scene, title or robot.name, _subtitle(robot, motion, title, beside)


def serve(scene: Scene, *, title: str, browser: bool) -> None:
    """Serve a scene until Ctrl-C."""
    # SIGTERM acts like Ctrl-C, so that the server does not outlive its parent.
    with signal_handler(signal.SIGTERM, signal.default_int_handler), LiveReplay() as live:
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


def _motion(
    robot: Robot, t: ArrayLike, qs: ArrayLike, speed: float, samples_per_second: float
) -> PlacementSamples:
    for name, value in (("speed", speed), ("samples_per_second", samples_per_second)):
        if not (np.isfinite(value) and value > 0.0):
            raise ReplayError(f"replay: {name}: got {value}, expected a positive number")
    try:
        return sample_motion(robot.model, t, qs, samples_per_second / speed)
    except (MbocpError, ValueError) as error:
        raise ReplayError(f"replay of {robot.name!r}: {error}") from error


def _ghosts(robot: Robot, t: ArrayLike, qs: ArrayLike, times: Sequence[float]) -> list[PlacementSamples]:
    """The robot's poses at the times, which are between the first and the last."""
    nodes = np.asarray(t, dtype=np.float64)
    for time in times:
        if not nodes[0] <= time <= nodes[-1]:
            raise ReplayError(
                f"replay: ghosts: got {time:g} s, expected times from {nodes[0]:g} to {nodes[-1]:g} s"
            )
    return [sample_motion(robot.model, [0.0], [pose_at(robot.model, t, qs, time)]) for time in times]


def _others(others: Sequence[OtherMotion], speed: float, samples_per_second: float) -> list[Other]:
    if len(others) > len(COLOURS):
        raise ReplayError(
            f"replay: got {1 + len(others)} motions, expected at most {1 + len(COLOURS)} in one picture"
        )
    motions = [_motion(other.robot, other.t, other.qs, speed, samples_per_second) for other in others]
    return [Other(other.robot, motion, other.name) for other, motion in zip(others, motions, strict=True)]


def _direction(degrees: tuple[float, float] | None) -> tuple[float, float] | None:
    if degrees is None:
        return None
    azimuth, elevation = degrees
    if not (np.isfinite(azimuth) and abs(elevation) <= _STEEPEST):
        raise ReplayError(
            f"replay: direction: got azimuth {azimuth:g} and elevation {elevation:g} [deg], "
            f"expected an elevation from -{_STEEPEST:g} to {_STEEPEST:g}"
        )
    return float(np.deg2rad(azimuth)), float(np.deg2rad(elevation))


def _subtitle(robot: Robot, motion: PlacementSamples, title: str, others: Sequence[Other]) -> str:
    shown = f"{motion.duration:.3g} s" if motion.duration > 0.0 else "one pose"
    words = [robot.name] if title and title != robot.name else []
    beside = [
        f"{colour}: {other.name}, {other.motion.duration:.3g} s"
        for colour, other in zip(COLOURS, others, strict=False)
    ]
    return " · ".join([*words, shown, *beside])
