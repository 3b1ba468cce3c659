"""Where tools and obstacles are."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array
from mbocp.problem import Problem
from mbocp.robot.collision.obstacle import Obstacle


def tool_of(problem: Problem) -> str:
    """The frame that is to reach the goal, or leaves a trace; else the last one."""
    for names in ([pose.name for pose in problem.goal.poses], problem.robot.trace_frames):
        if names:
            return str(names[0])
    return str(problem.robot.frame_names[-1])


def box_around(obstacle: Obstacle) -> tuple[Array, Array]:
    """Centre and half the sides of a box around an obstacle, along its frame's axes [m]."""
    shape, place = obstacle.geometry, obstacle.placement
    shape.computeLocalAABB()
    low, high = np.asarray(shape.aabb_local.min_), np.asarray(shape.aabb_local.max_)
    centre = place.translation + place.rotation @ (0.5 * (low + high))
    return centre, np.abs(place.rotation) @ (0.5 * (high - low))
