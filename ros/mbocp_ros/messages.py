"""Messages of ROS from motions, and mappings by joint from messages; the classes of messages are given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from mbocp.exceptions import DimensionMismatch, ProblemError
from mbocp.solution.sampled import sample
from mbocp_ros.planner import Motion

_AT_REST = 1e-6  # [rad/s, m/s]: controllers refuse a motion that does not end at zero
_NEAREST = 1e-4  # [s] before a stop, that points are apart from it


@dataclass(frozen=True)
class MessageClasses:
    """Classes of the messages that make a trajectory.

    Attributes
    ----------
    trajectory, point : type
        Of trajectory_msgs/msg: JointTrajectory, JointTrajectoryPoint.
    duration, time : type
        Of builtin_interfaces/msg: Duration, Time.
    """

    trajectory: Any
    point: Any
    duration: Any
    time: Any


def trajectory_message(
    motion: Motion, start: int, classes: MessageClasses, *, has_efforts: bool = False
) -> Any:
    """Make the JointTrajectory of a motion; points have no accelerations where cubics are meant.

    Parameters
    ----------
    motion : Motion
    start : int
        When it begins, by the clock of ROS [ns].
    classes : MessageClasses
    has_efforts : bool
        Whether points have the efforts of the motion as it is sent [N m, N], which controllers refuse that
        have no command interface of efforts.

    Raises
    ------
    ProblemError
        If efforts are asked for, and a joint has no motor of its name.
    """
    message = classes.trajectory()
    message.header.stamp = _of_nanoseconds(classes.time, start)
    parts = ((motion.stopped, motion.begin - _NEAREST), (motion, np.inf))
    for part, until in ((part, until) for part, until in parts if part is not None):
        load_robot = partial(getattr, part.solution.problem, "robot") if has_efforts else None
        points = sample(part.sent, load_robot)
        free = [name for name, u in zip(points.joints, points.efforts[0], strict=True) if not np.isfinite(u)]
        if has_efforts and free:
            raise ProblemError(f"efforts: joint {free[0]!r} has no motor of its name; leave efforts out")
        velocities = points.velocities.copy()
        velocities[-1] = np.where(np.abs(velocities[-1]) < _AT_REST, 0.0, velocities[-1])
        message.joint_names = list(points.joints)
        for k in np.flatnonzero(points.t < until):
            point = classes.point()
            point.positions = (points.positions[k] + part.turns).tolist()
            point.velocities = velocities[k].tolist()
            if points.interpolation == "quintic":
                point.accelerations = points.accelerations[k].tolist()
            if has_efforts:
                point.effort = points.efforts[k].tolist()
            point.time_from_start = _of_nanoseconds(
                classes.duration, round(float(part.begin + points.t[k]) * 1e9)
            )
            message.points.append(point)
    return message


def joint_state(message: Any) -> tuple[Mapping[str, float], Mapping[str, float]]:
    """Positions [rad, m] and velocities [rad/s, m/s] by joint of a JointState, where it has them."""
    q = dict(zip(message.name, map(float, message.position), strict=False))
    return q, dict(zip(message.name, map(float, message.velocity), strict=False))


def goal_positions(message: Any) -> Mapping[str, float]:
    """Positions by joint [rad, m] of a JointTrajectory of one point, which is a goal.

    Raises
    ------
    MbocpError
        If it has several points, or ends in motion, or names and positions are not as many.
    """
    if len(message.points) != 1:
        raise ProblemError(f"goal: got {len(message.points)} points, expected one, where the motion ends")
    (point,) = message.points
    if any(point.velocities):
        raise ProblemError("goal: velocities must be zero: motions end at rest")
    if len(point.positions) != len(message.joint_names):
        raise DimensionMismatch("goal", len(point.positions), len(message.joint_names))
    return dict(zip(message.joint_names, map(float, point.positions), strict=True))


def _of_nanoseconds(kind: Any, nanoseconds: int) -> Any:
    """Return a Time or Duration."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return kind(sec=seconds, nanosec=rest)
