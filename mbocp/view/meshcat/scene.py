"""A motion as a meshcat scene: the robot, its connectors, traces, floor, lights, camera and animation."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mbocp._arrays import Array, dataclass
from mbocp.robot import FrameTarget, LinkSpheres, Robot
from mbocp.view.camera import Camera, fit_camera, upright
from mbocp.view.marks import Marks
from mbocp.view.meshcat.arrows import connector_commands, force_arrows
from mbocp.view.meshcat.commands import (
    Command,
    Track,
    mg,
    set_animation,
    set_object,
    set_transform,
    shape_object,
)
from mbocp.view.meshcat.ghosts import (
    Other,
    ghost_commands,
    ghost_points,
    joint_tracks,
    other_commands,
    other_tracks,
    path_points,
    robot_commands,
)
from mbocp.view.meshcat.goals import (
    axis_points,
    goal_commands,
    goal_placements,
    mark_commands,
    mark_points,
    obstacle_commands,
    obstacle_points,
    obstacle_tracks,
    sphere_commands,
)
from mbocp.view.meshcat.shapes import path_tube
from mbocp.view.meshcat.surroundings import floor_height, stage_commands
from mbocp.view.meshcat.visuals import MeshLibrary
from mbocp.view.motion_samples import PlacementSamples

ROOT = "/replay"
WORLD = f"{ROOT}/world"  # turned so that gravity points down
FORCES = f"{WORLD}/forces"
HOLD = 0.8  # [s] the last pose stays before the loop starts again
TRACE_POINTS = 400  # of one traced frame
SWEEP_POSES = 60  # poses that the camera has to hold
_TRACE_COLOURS = (  # from the start to the end of a path, RGB
    ((1.00, 0.80, 0.35), (0.85, 0.20, 0.10)),
    ((0.55, 0.85, 1.00), (0.05, 0.30, 0.70)),
    ((0.75, 0.92, 0.55), (0.10, 0.50, 0.20)),
    ((0.90, 0.75, 1.00), (0.45, 0.15, 0.60)),
)


@dataclass(frozen=True)
class Scene:
    """A scene as messages for a viewer.

    Attributes
    ----------
    commands : tuple of Command
        Everything but the animation, in the order it must arrive.
    animation : Command or None
        Animation of all moving nodes; None if nothing moves.
    camera : Camera
        The camera that the commands set, for a page that adapts it to its window.
    duration : float
        Length of the motion [s].
    forces : str
        Scale of arrows of forces; empty where there are none.
    size : float
        Extent of what moves [m].
    floor : float
        Height of the floor [m].
    """

    commands: tuple[Command, ...]
    animation: Command | None
    camera: Camera
    duration: float
    forces: str = ""
    size: float = 1.0
    floor: float = 0.0


def build_scene(
    robot: Robot,
    motion: PlacementSamples,
    *,
    trace: Sequence[str] | None = None,
    goals: Sequence[FrameTarget] = (),
    other_goals: Sequence[FrameTarget] = (),
    marks: Marks | None = None,
    spheres: Sequence[LinkSpheres] = (),
    ghosts: Sequence[PlacementSamples] = (),
    others: Sequence[Other] = (),
    speed: float = 1.0,
    direction: tuple[float, float] | None = None,
) -> Scene:
    """Compose the scene of a motion.

    Parameters
    ----------
    robot : Robot
    motion : PlacementSamples
    trace : sequence of str, optional
        Frames whose path is drawn; by default the robot's own choice.
    goals : sequence of FrameTarget
        Poses of frames whose axes are drawn.
    other_goals : sequence of FrameTarget
        Those of which the motion goes to another: faint.
    marks : Marks, optional
        Via points, lines, obstacles and forces.
    spheres : sequence of LinkSpheres
        Spheres that are drawn over the robot.
    ghosts : sequence of PlacementSamples
        Poses in which the robot is drawn once more, faint.
    others : sequence of Other
        Motions of other results, shown at the same time.
    speed : float
        Seconds of motion per second of watching; the animation's key times are divided by it.
    direction : (float, float), optional
        Azimuth and elevation from which the camera looks [rad]; by default where most can be seen.

    Raises
    ------
    UnknownFrame
        If a traced frame does not exist.
    """
    frames = [robot.frame_id(name) for name in (robot.trace_frames if trace is None else trace)]
    paths = [motion.frame_positions(frame) for frame in frames]
    turn = upright(robot.model.gravity.linear)
    node = partial(joint_node, motion)
    drawn, corners = robot_commands(robot, MeshLibrary(robot), motion, node)
    placements = goal_placements(robot, [*goals, *other_goals], motion.qs[-1])
    ends = [np.tile(placed.translation, (len(motion.times), 1)) for placed in placements]
    drawn_marks = marks or Marks()
    tips = (motion.frame_positions(tip) for c in robot.connectors for tip in (c.frame_a, c.frame_b))
    lines = [*paths, *tips, *ends, *mark_points(robot, drawn_marks, motion)]
    lines += [np.tile(point, (len(motion.times), 1)) for point in ghost_points(robot, ghosts)]
    swept = (
        np.vstack([_sweep(motion, corners, lines), *(path_points(other.motion) for other in others)]) @ turn.T
    )
    size = max(float(np.linalg.norm(np.ptp(swept, axis=0))), 1e-3)
    picked = _poses(motion)
    joints = motion.positions[picked, 1:].reshape(-1, 3)
    boxes = np.reshape(obstacle_points(robot, drawn_marks.obstacles), (-1, 8, 3))
    camera = fit_camera(
        np.vstack([swept, axis_points(placements, size) @ turn.T]),
        np.vstack([joints, *(x[picked] for x in lines)]) @ turn.T,
        direction,
        moving=joints @ turn.T,
        obstacles=list(boxes @ turn.T),
    )
    along, tracks_along = motion_commands(robot, motion, frames, size)
    arrows = force_arrows(drawn_marks.forces, motion, FORCES, size)
    commands = [
        *stage_commands(swept, size, camera, ROOT),
        set_transform(WORLD, turn, np.zeros(3)),
        *drawn,
        *along,
        *goal_commands([*goals, *other_goals], placements, WORLD, size, bold=len(goals)),
        *mark_commands(robot, drawn_marks, motion, WORLD, size),
        *obstacle_commands(robot, drawn_marks.obstacles, node, size),
        *sphere_commands(robot, spheres, node),
        *ghost_commands(robot, ghosts, WORLD),
        *other_commands(others, WORLD),
        *arrows.commands,
    ]
    tracks = [*joint_tracks(motion, node), *tracks_along, *arrows.tracks, *other_tracks(others, WORLD)]
    tracks += obstacle_tracks(drawn_marks.obstacles, motion.times, node(0))
    duration = max([motion.duration, *(other.motion.duration for other in others)])
    timed = [Track(track.path, track.name, track.times / speed, track.values) for track in tracks]
    animation = set_animation(timed, duration / speed + HOLD) if timed else None
    floor = floor_height(swept, size)
    return Scene(tuple(commands), animation, camera, duration, arrows.words, size, floor)


def motion_commands(
    robot: Robot, motion: PlacementSamples, frames: Sequence[int], size: float
) -> tuple[list[Command], list[Track]]:
    """What is drawn anew with another motion: rods and springs, and the paths of frames.

    Parameters
    ----------
    frames : sequence of int
        Frames that leave a trace.
    size : float
        Extent of the scene [m].
    """
    commands, tracks = connector_commands(robot.connectors, motion, WORLD, size)
    paths = (motion.frame_positions(frame) for frame in frames)
    return [*commands, *_trace_commands(robot, frames, paths, size)], tracks


def joint_node(motion: PlacementSamples, joint: int) -> str:
    """Path of a joint's node; a slash in a name would start another node."""
    return f"{WORLD}/robot/{motion.model.names[joint].replace('/', '|')}"


def _poses(motion: PlacementSamples) -> NDArray[np.int64]:
    """Numbers of some poses, evenly spread, the first and the last among them."""
    return np.unique(np.linspace(0, len(motion.times) - 1, SWEEP_POSES).astype(np.int64))


def _sweep(motion: PlacementSamples, corners: dict[int, list[Array]], lines: Sequence[Array]) -> Array:
    """Points (M, 3) whose hull contains all moving bodies and those near them."""
    picked = _poses(motion)
    clouds = [*lines] if corners else [*lines, motion.positions[picked, 1:].reshape(-1, 3)]
    for joint, boxes in corners.items():
        if joint:
            R, p = motion.rotations[picked, joint], motion.positions[picked, joint]
            clouds.append((np.einsum("fij,kj->fki", R, np.vstack(boxes)) + p[:, None, :]).reshape(-1, 3))
    standing = np.vstack(corners.get(0, [np.empty((0, 3))]))
    if not clouds:
        return standing
    moving = np.vstack(clouds)
    low, high = moving.min(axis=0), moving.max(axis=0)
    margin = 0.3 * float(np.linalg.norm(high - low))  # of a long rail or a large table only the part near by
    return np.vstack([moving, np.clip(standing, low - margin, high + margin)])


def _trace_commands(
    robot: Robot, frames: Iterable[int], paths: Iterable[Array], size: float
) -> Iterator[Command]:
    for k, (frame, path) in enumerate(zip(frames, paths, strict=True)):
        if float(np.linalg.norm(np.ptp(path, axis=0))) < 1e-4 * size:
            continue  # it stays where it is
        points = path[np.unique(np.linspace(0, len(path) - 1, TRACE_POINTS).astype(int))]
        start, end = np.array(_TRACE_COLOURS[k % len(_TRACE_COLOURS)])
        colours = start + np.linspace(0.0, 1.0, len(points))[:, None] * (end - start)
        material = mg.MeshLambertMaterial(vertexColors=True)
        tube = path_tube(points, 0.0022 * size, colours)
        name = robot.model.frames[frame].name.replace("/", "|")
        yield set_object(f"{WORLD}/trace/{name}", shape_object(tube, material))
