"""A robot in another pose, faint: where it is to end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import ReplayError
from mbocp.view.meshcat.commands import Command, set_object, set_transform
from mbocp.view.meshcat.skeleton import joints_without_visuals, skeleton
from mbocp.view.meshcat.visuals import MeshLibrary
from mbocp.view.motion import Motion

if TYPE_CHECKING:
    from mbocp.robot import Robot

__all__ = ["ghost_commands", "ghost_points"]

_OPACITY = 0.35


def ghost_points(robot: Robot, poses: Sequence[Motion]) -> list[Array]:
    """Places of the joints in each pose, shape (1, 3) each [m], for the camera."""
    return [pose.positions[0, joint][None, :] for pose in poses for joint in range(1, robot.model.njoints)]


def ghost_commands(robot: Robot, poses: Sequence[Motion], root: str) -> Iterator[Command]:
    """Draw the robot, faint, in each of the poses.

    Parameters
    ----------
    robot : Robot
    poses : sequence of Motion
        Each of one pose.
    root : str
        Node under which they are drawn.
    """
    library, missing = MeshLibrary(robot), joints_without_visuals(robot)
    for k, pose in enumerate(poses):
        for joint in range(robot.model.njoints):
            yield set_transform(_node(root, k, joint), pose.rotations[0, joint], pose.positions[0, joint])
        for index, visual in enumerate(robot.visual_model.geometryObjects):
            joint, path = visual.parentJoint, f"{_node(root, k, visual.parentJoint)}/{index}"
            if joint == 0:
                continue  # stands where the robot stands
            try:
                drawn = _faint(library.draw(visual))
            except ReplayError:  # told where the robot itself is drawn
                missing.add(joint)
                continue
            yield set_object(path, drawn)
            yield set_transform(path, visual.placement.rotation, visual.placement.translation)
        for joint, sticks, _ in skeleton(robot.model, missing):
            for i, stick in enumerate(sticks):
                yield set_object(f"{_node(root, k, joint)}/stick_{i}", _faint(stick))


def _node(root: str, number: int, joint: int) -> str:
    return f"{root}/ghost_{number}/joint_{joint}"


def _faint(drawn: dict[str, Any]) -> dict[str, Any]:
    """The same object with materials that one sees through."""
    materials = [
        {
            **material,
            "transparent": True,
            "opacity": _OPACITY * float(np.clip(material.get("opacity", 1.0), 0, 1)),
        }
        for material in drawn.get("materials", ())
    ]
    return {**drawn, "materials": materials}
