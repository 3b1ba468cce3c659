"""Collision geometry in a replay: the spheres that stand for links."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mbocp.view.meshcat.commands import Command, colour_number, set_object, set_transform, shape_object
from mbocp.view.meshcat.viewer import mg

if TYPE_CHECKING:
    from mbocp.robot import LinkSpheres, Robot

__all__ = ["sphere_commands"]

_SPHERE = (0.10, 0.45, 0.85)  # RGB
_OPACITY = 0.35


def sphere_commands(
    robot: Robot, spheres: Sequence[LinkSpheres], node: Callable[[int], str]
) -> Iterator[Command]:
    """Draw spheres that move with their joints.

    Parameters
    ----------
    robot : Robot
    spheres : sequence of LinkSpheres
    node : callable
        Path of a joint's node by the index of the joint.
    """
    material = mg.MeshPhongMaterial(color=colour_number(_SPHERE), transparent=True, opacity=_OPACITY)
    for link in spheres:
        placement = robot.model.frames[link.frame].placement
        for number, (center, radius) in enumerate(zip(link.centers, link.radii, strict=True)):
            path = f"{node(link.joint)}/spheres/{link.link.replace('/', '|')}_{number}"
            yield set_object(path, shape_object(mg.Sphere(float(radius)), material))
            yield set_transform(path, np.eye(3), placement.act(np.array(center)))
