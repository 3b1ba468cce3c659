"""A robot whose motion a result says, as an obstacle: the spheres of its links, which move by the time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError, ResultFileError
from mbocp.robot import Robot, robot_from_spec
from mbocp.robot.collision.motion import ObstacleMotion
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.robot.large import working_data
from mbocp.robot.nodes import between
from mbocp.storage.seal import read_image


def spheres_of_result(path: Path, base: pin.SE3, name: str, margin: float) -> tuple[Obstacle, ...]:
    """Make an obstacle of each sphere of the robot of a result.

    Parameters
    ----------
    path : Path
        Of the result.
    base : pin.SE3
        Where the robot's world is.
    name : str
        What the robot is called.
    margin : float
        [m].

    Raises
    ------
    ProblemError
        If there is no such result, or its robot has no collision geometry.
    """
    robot, t, qs = _read(path)
    if not robot.collision_spheres:
        raise ProblemError(f"result: robot {robot.name!r} of {path} has no collision geometry")
    middles = between(robot, qs[:-1], qs[1:], np.full(len(qs) - 1, 0.5))
    times, order = np.unique(np.concatenate([t, (t[:-1] + t[1:]) / 2.0]), return_index=True)
    poses = _link_poses(robot, base, np.vstack([qs, middles])[order])
    found = []
    for link, along in zip(robot.collision_spheres, poses, strict=True):
        motion = ObstacleMotion.through(times, along[:, :3], along[:, 3:])
        for number, (center, radius) in enumerate(zip(link.centers, link.radii, strict=True)):
            named, size = f"{name}/{link.link}[{number}]", np.array([radius])
            sphere = Obstacle(
                name=named, shape="sphere", sizes=size, position=center, margin=margin, motion=motion
            )
            found.append(sphere)
    return tuple(found)


def _read(path: Path) -> tuple[Robot, Array, Array]:
    """Robot, times and configurations; impacts, which take no time, once."""
    from mbocp.storage.hdf5 import content_of  # HDF5 only for those who name a result

    if not path.is_file():
        raise ProblemError(f"result: no such file {str(path)!r}")
    try:
        content = content_of(path, read_image(path))
    except ResultFileError as error:
        raise ProblemError(f"result: {path} {error.reason}") from error
    t, qs = content.arrays["t"], content.arrays["qs"]
    t, once = np.unique(t, return_index=True)
    return robot_from_spec(content.structures["robot_spec"]), t, qs[once]


def _link_poses(robot: Robot, base: pin.SE3, qs: Array) -> Array:
    """Positions and quaternions of the frames with spheres, shape (links, n, 7)."""
    data = working_data(robot.model)
    found = np.empty((len(robot.collision_spheres), len(qs), 7))
    for n, q in enumerate(qs):
        pin.framesForwardKinematics(robot.model, data, q)
        for k, link in enumerate(robot.collision_spheres):
            found[k, n] = pin.SE3ToXYZQUAT(base * data.oMf[link.frame])
    return found
