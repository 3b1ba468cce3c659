"""Collision geometry in a replay: obstacles, and the spheres that stand for links."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.meshes.parts import MeshPart
from mbocp.robot import LinkSpheres, Robot
from mbocp.robot.collision.hull import Hull
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.view.meshcat.commands import Command, colour_number, set_object, set_transform, shape_object
from mbocp.view.meshcat.viewer import load_primitive, mg
from mbocp.view.meshcat.visuals import MergedGeometry

_SPHERE = (0.10, 0.45, 0.85)  # RGB
_OPACITY = 0.35
_OBSTACLE = (0.80, 0.36, 0.22)  # RGB
_SOLID = 0.75  # opacity
_PLATE = 2.0  # side of the plate that stands for a halfspace, in sizes of the scene
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)


def obstacle_points(robot: Robot, obstacles: Sequence[Obstacle]) -> list[Array]:
    """Corners of the boxes around obstacles that stand in the world, each of shape (3,) [m]."""
    found: list[Array] = []
    for obstacle in obstacles:
        frame = robot.model.frames[robot.frame_id(obstacle.frame)]
        if obstacle.shape == "halfspace" or frame.parentJoint:
            continue
        shape = obstacle.geometry
        shape.computeLocalAABB()
        low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
        corners = (low + high) / 2.0 + _CORNERS * (high - low) / 2.0
        found += [(frame.placement * obstacle.placement).act(corner) for corner in corners]
    return found


def obstacle_commands(
    robot: Robot, obstacles: Sequence[Obstacle], node: Callable[[int], str], size: float
) -> Iterator[Command]:
    """Draw obstacles, in the world or with the joint that carries them; of a halfspace a plate.

    Parameters
    ----------
    robot : Robot
    obstacles : sequence of Obstacle
    node : callable
        Path of a joint's node by the index of the joint.
    size : float
        Extent of the scene [m].
    """
    for number, obstacle in enumerate(obstacles):
        frame = robot.model.frames[robot.frame_id(obstacle.frame)]
        joint, placed = int(frame.parentJoint), frame.placement * obstacle.placement
        is_plate = obstacle.shape == "halfspace"
        opacity = _OPACITY if is_plate else _SOLID
        material = mg.MeshPhongMaterial(color=colour_number(_OBSTACLE), transparent=True, opacity=opacity)
        if is_plate:
            drawn = mg.Box([_PLATE * size, _PLATE * size, 1e-3 * size])
        elif obstacle.hull is not None:
            drawn = MergedGeometry([_flat_sides(obstacle.hull)], [None])
        else:
            drawn = load_primitive(pin.GeometryObject(obstacle.name, joint, placed, obstacle.geometry))
        path = f"{node(joint)}/obstacles/{number}_{obstacle.name.replace('/', '|')}"
        yield set_object(path, shape_object(drawn, material))
        yield set_transform(path, placed.rotation, placed.translation)


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


def _flat_sides(hull: Hull) -> MeshPart:
    """A hull whose triangles have no corner in common, so that edges are seen."""
    vertices = hull.vertices[hull.faces.ravel()]
    faces = np.arange(len(vertices)).reshape(-1, 3)
    return MeshPart(vertices, faces, np.repeat(hull.normals, 3, axis=0), None, None)
