"""Panels of a motion in space: positions and speeds of frames, distances to what it keeps clear of."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.problem.obstacles.approach import clearances_along
from mbocp.robot.large import working_data
from mbocp.solution import Column
from mbocp.view.figures.lines import LinePanel, line_panels

if TYPE_CHECKING:
    from mbocp.problem import Problem
    from mbocp.robot import Robot
    from mbocp.solution import Solution


def frame_panels(solution: Solution, robot: Robot) -> list[LinePanel]:
    """Return where the frames that the robot traces are, and how fast they go, in the world's axes."""
    names = robot.trace_frames
    places, speeds = _follow_frames(robot, solution)
    found = []
    for name, place in zip(names, places, strict=True):
        axes = [Column(axis, "m") for axis in "xyz"]
        found += line_panels(f"Position of {name}", "$p$", axes, solution.t, place)
    columns = [Column(name, "m/s") for name in names]
    return [*found, *line_panels("Speed in space", "$|\\dot p|$", columns, solution.t, speeds)]


def _follow_frames(robot: Robot, solution: Solution) -> tuple[Array, Array]:
    """Positions of the traced frames, shape (frames, N + 1, 3) [m], and speeds, (N + 1, frames) [m/s]."""
    ids = [robot.frame_id(name) for name in robot.trace_frames]
    model, data = robot.model, working_data(robot.model)
    places = np.empty((len(ids), len(solution.t), 3))
    speeds = np.empty((len(solution.t), len(ids)))
    for n, (q, v) in enumerate(zip(solution.qs, solution.vs, strict=True)):
        pin.forwardKinematics(model, data, q, v)
        for i, frame in enumerate(ids):
            places[i, n] = pin.updateFramePlacement(model, data, frame).translation
            velocity = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            speeds[n, i] = np.linalg.norm(velocity.linear)
    return places, speeds


def clearance_panels(solution: Solution, problem: Problem) -> list[LinePanel]:
    """Return the smallest distance of what the problem keeps apart, at the nodes; nothing without such."""
    if problem.clearance is None:
        return []
    columns = [Column("nearest pair of those that are checked", "m")]
    distances = clearances_along(problem.clearance, solution.qs)[:, None]
    return line_panels("Clearance", "$d$", columns, solution.t, distances)
