"""Goals of frames in a replay: the axes of the pose that was asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.view.meshcat.commands import Command, set_object, set_transform, shape_object
from mbocp.view.meshcat.shapes import tube
from mbocp.view.meshcat.viewer import mg

if TYPE_CHECKING:
    from mbocp.robot import FrameTarget, Robot

__all__ = ["goal_commands", "goal_placements"]

_LENGTH, _RADIUS = 0.08, 0.004  # of the scene's size
_FAINT = 0.3  # opacity
_COLOURS = ((0.85, 0.15, 0.15), (0.15, 0.65, 0.2), (0.15, 0.3, 0.85))  # x, y, z


def goal_placements(robot: Robot, goals: Sequence[FrameTarget], q: Array) -> list[pin.SE3]:
    """Placement in the world of each goal; what it leaves free is as at the configuration q."""
    found = []
    for goal in goals:
        reference = robot.frame_placement(goal.relative_to, q)
        found.append(reference * goal.completed(robot.frame_placement(goal.name, q, goal.relative_to)))
    return found


def goal_commands(
    goals: Sequence[FrameTarget], placements: Sequence[pin.SE3], root: str, size: float, bold: int
) -> Iterator[Command]:
    """Draw three axes for each goal.

    Parameters
    ----------
    root : str
        Node of the scene.
    size : float
        Extent of the scene [m].
    bold : int
        How many of them, from the first; the others are faint.
    """
    for index, (goal, placed) in enumerate(zip(goals, placements, strict=True)):
        path = f"{root}/goals/{index}_{goal.name.replace('/', '|')}"
        for axis, colour in enumerate(_COLOURS):
            line = np.zeros((2, 3))
            line[1, axis] = _LENGTH * size
            faint = {} if index < bold else {"transparent": True, "opacity": _FAINT}
            material = mg.MeshLambertMaterial(vertexColors=True, **faint)
            drawn = tube(line, _RADIUS * size, np.tile(colour, (2, 1)))
            yield set_object(f"{path}/{'xyz'[axis]}", shape_object(drawn, material))
        yield set_transform(path, placed.rotation, placed.translation)
