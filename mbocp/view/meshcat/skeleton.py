"""A stick figure for joints without a mesh: balls at joints, rods from each joint to the next."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot import Robot
from mbocp.robot.payload import shape_name
from mbocp.view.meshcat.commands import shape_object
from mbocp.view.meshcat.shapes import tube
from mbocp.view.meshcat.viewer import mg

_BALL, _ROD = 0xD9822B, 0x5B7FA6


def joints_without_visuals(robot: Robot) -> set[int]:
    """Joints to draw as sticks: all if the robot has no visual at all, else those with missing meshes."""
    carried = {shape_name(payload) for payload in robot.payloads}
    visuals = [visual for visual in robot.visual_model.geometryObjects if visual.name not in carried]
    if not robot.parts:
        return _bare(robot, visuals, range(robot.model.njoints), "")
    found = set[int]()
    for part in robot.parts:
        own = [visual for visual in visuals if visual.name.startswith(part.prefix)]
        joints = [j for j in range(robot.model.njoints) if robot.model.names[j].startswith(part.prefix)]
        found |= _bare(robot, own, joints, part.prefix)
    return found


def _bare(
    robot: Robot, visuals: Sequence[pin.GeometryObject], joints: Iterable[int], prefix: str
) -> set[int]:
    """All `joints` if they have no visual at all, else those with missing meshes."""
    if len(visuals) == 0:
        return set(joints)
    seen = {robot.model.frames[visual.parentFrame].name for visual in visuals}
    drawn = {source.prefix + link for source in robot.shapes for link in source.drawn}
    links = {link for link in drawn - seen if link.startswith(prefix)}
    bodies = (frame for frame in robot.model.frames if frame.type == pin.FrameType.BODY)
    return {frame.parentJoint for frame in bodies if frame.name in links}


def skeleton(model: pin.Model, joints: set[int]) -> Iterator[tuple[int, list[dict[str, Any]], Array]]:
    """Sticks of some joints.

    Yields
    ------
    joint : int
    sticks : list of dict
        Objects in the joint's frame.
    points : ndarray, shape (K, 3)
        The ends of the sticks in the joint's frame [m].
    """
    ends = {joint: _ends(model, joint) for joint in joints}
    lengths = [
        length for points in ends.values() for length in np.linalg.norm(points, axis=1) if length > 1e-6
    ]
    radius = 0.09 * float(np.median(lengths)) if lengths else 0.02  # [m]
    ball_material = mg.MeshPhongMaterial(color=_BALL)
    rod_material = mg.MeshPhongMaterial(color=_ROD)
    for joint, points in ends.items():
        sticks = [shape_object(mg.Sphere(radius), ball_material)] if joint else []
        for point in points:
            if np.linalg.norm(point) > radius:
                rod = tube(np.array([np.zeros(3), point]), 0.6 * radius, sides=12)
                sticks.append(shape_object(rod, rod_material))
        if sticks:
            yield (
                joint,
                sticks,
                np.vstack([np.zeros((1, 3)), points, *(radius * np.vstack([np.eye(3), -np.eye(3)]),)]),
            )


def _ends(model: pin.Model, joint: int) -> Array:
    """Ends of a joint's sticks: its child joints, or the farthest frame of a last link."""
    children = [k for k in range(1, model.njoints) if model.parents[k] == joint]
    if joint == 0:
        # A floating base is not tied to the origin.
        children = [k for k in children if model.joints[k].nq < 6]
    if children:
        return np.array([model.jointPlacements[k].translation for k in children])
    carried = [frame.placement.translation for frame in model.frames if frame.parentJoint == joint and joint]
    carried.append(model.inertias[joint].lever)
    return np.array([max(carried, key=lambda point: float(np.linalg.norm(point)))])
