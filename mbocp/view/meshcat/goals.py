"""What a robot is to reach and to keep away from, in a replay: poses, via points, lines, obstacles."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.meshes.mesh_parts import Indices, MeshPart
from mbocp.robot import LinkSpheres, Robot
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.robot.collision.solid import CORNERS, box_around
from mbocp.view.marks import Marks
from mbocp.view.meshcat.commands import (
    Command,
    Track,
    colour_number,
    load_primitive,
    mg,
    set_object,
    set_transform,
    shape_object,
)
from mbocp.view.meshcat.shapes import tube
from mbocp.view.meshcat.visuals import MergedGeometry
from mbocp.view.motion_samples import PlacementSamples

if TYPE_CHECKING:
    from mbocp.robot import FrameTarget, Robot
    from mbocp.terms.frame_goal import FrameGoal

_LENGTH, _RADIUS = 0.08, 0.004  # of the scene's size
_FAINT = 0.3  # opacity
_BALL = 0.012
_VIA, _LINE = (0.95, 0.55, 0.1), (0.3, 0.3, 0.3)  # RGB
_COLOURS = ((0.85, 0.15, 0.15), (0.15, 0.65, 0.2), (0.15, 0.3, 0.85))  # x, y, z
_SPHERE = (0.10, 0.45, 0.85)  # RGB
_OPACITY = 0.35
_OBSTACLE = (0.80, 0.36, 0.22)  # RGB
_SOLID = 0.75  # opacity
_PLATE = 2.0  # side of the plate that stands for a halfspace, in sizes of the scene


def goal_placements(robot: Robot, goals: Sequence[FrameTarget], q: Array) -> list[pin.SE3]:
    """Placement in the world of each goal; what it leaves free is as at the configuration q."""
    found = []
    for goal in goals:
        reference = robot.frame_placement(goal.relative_to, q)
        found.append(reference * goal.complete(robot.frame_placement(goal.name, q, goal.relative_to)))
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


def axis_points(placements: Sequence[pin.SE3], size: float) -> Array:
    """Ends of the axes that `goal_commands` draws, shape (3 k, 3) [m]."""
    ends = [placed.translation + _LENGTH * size * placed.rotation.T for placed in placements]
    return np.concatenate([np.zeros((0, 3)), *ends])


def mark_points(robot: Robot, marks: Marks, motion: PlacementSamples) -> list[Array]:
    """Points that the picture is to hold, as paths of the length of the motion."""
    points: list[Array] = []
    for mark, placed in zip(marks.via, _via_placements(robot, marks, motion), strict=True):
        sides = mark.goal.position_tolerance
        base = _reference(robot, mark.goal, _at(motion, mark.share))
        corners = np.zeros((1, 3)) if sides is None else CORNERS * sides
        points += [*(placed.translation + corners @ base.rotation.T)]
    points += [point for line in marks.lines for point in line]
    points += obstacle_points(robot, marks.obstacles)
    return [np.tile(point, (len(motion.times), 1)) for point in points]


def mark_commands(
    robot: Robot, marks: Marks, motion: PlacementSamples, root: str, size: float
) -> Iterator[Command]:
    """Draw a ball or its box at each via point, its axes where it has an orientation, and all lines.

    Parameters
    ----------
    root : str
        Node of the scene.
    size : float
        Extent of the scene [m].
    """
    for index, (mark, placed) in enumerate(
        zip(marks.via, _via_placements(robot, marks, motion), strict=True)
    ):
        path = f"{root}/via/{index}"
        target = mark.goal.target
        if target.coordinates.size and mark.goal.position_tolerance is None:
            ball = mg.Sphere(_BALL * size)
            material = mg.MeshLambertMaterial(color=colour_number(_VIA))
            yield set_object(f"{path}/ball", shape_object(ball, material))
            yield set_transform(f"{path}/ball", np.eye(3), placed.translation)
        if target.orientation is not None or target.axis is not None:
            yield from goal_commands([target], [placed], path, size, bold=1)
        if mark.goal.position_tolerance is not None:
            base = _reference(robot, mark.goal, _at(motion, mark.share))
            for number, edge in enumerate(_edges(mark.goal.position_tolerance)):
                line = placed.translation + edge @ base.rotation.T
                yield set_object(f"{path}/edge_{number}", _tube(line, 0.5 * _RADIUS * size, _VIA))
    for index, line in enumerate(marks.lines):
        yield set_object(f"{root}/lines/{index}", _tube(line, 0.4 * _RADIUS * size, _LINE))


def _via_placements(robot: Robot, marks: Marks, motion: PlacementSamples) -> list[pin.SE3]:
    return [goal_placements(robot, [mark.goal.target], _at(motion, mark.share))[0] for mark in marks.via]


def _reference(robot: Robot, goal: FrameGoal, q: Array) -> pin.SE3:
    return robot.frame_placement(goal.target.relative_to, q)


def _at(motion: PlacementSamples, share: float) -> Array:
    """Configuration when a part of the motion is over."""
    return motion.qs[int(np.argmin(np.abs(motion.times - share * motion.duration)))]


def _edges(sides: Array) -> list[Array]:
    """The twelve edges of a box with these half sides, each of shape (2, 3)."""
    pairs = [(a, b) for i, a in enumerate(CORNERS) for b in CORNERS[:i] if np.sum(a != b) == 1]
    return [np.array(pair) * sides for pair in pairs]


def _tube(line: Array, radius: float, colour: tuple[float, float, float]) -> Any:
    material = mg.MeshLambertMaterial(vertexColors=True)
    return shape_object(tube(line, radius, np.tile(colour, (len(line), 1))), material)


def obstacle_points(robot: Robot, obstacles: Sequence[Obstacle]) -> list[Array]:
    """Corners of the boxes around obstacles that stand in the world, each of shape (3,) [m]."""
    found: list[Array] = []
    for obstacle in obstacles:
        if obstacle.motion is not None:  # it may come from far away
            continue
        frame = robot.model.frames[robot.frame_id(obstacle.frame)]
        if obstacle.shape == "halfspace" or frame.parentJoint:
            continue
        placed = frame.placement * obstacle.placement
        found += [placed.act(corner) for corner in box_around(obstacle.geometry)]
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
        joint, placed = int(frame.parentJoint), frame.placement * obstacle.placements(np.zeros(1))[0]
        is_plate = obstacle.shape == "halfspace"
        opacity = _OPACITY if is_plate else _SOLID
        material = mg.MeshPhongMaterial(color=colour_number(_OBSTACLE), transparent=True, opacity=opacity)
        if is_plate:
            drawn = mg.Box([_PLATE * size, _PLATE * size, 1e-3 * size])
        elif (body := obstacle.hull or obstacle.compound) is not None:
            drawn = MergedGeometry([_flat_sides(body.vertices, body.faces)], [None])
        else:
            drawn = load_primitive(pin.GeometryObject(obstacle.name, joint, placed, obstacle.geometry))
        path = _obstacle_node(node(joint), number, obstacle)
        yield set_object(path, shape_object(drawn, material))
        yield set_transform(path, placed.rotation, placed.translation)


def _obstacle_node(carrier: str, number: int, obstacle: Obstacle) -> str:
    return f"{carrier}/obstacles/{number}_{obstacle.name.replace('/', '|')}"


def obstacle_tracks(obstacles: Sequence[Obstacle], times: Array, world: str) -> Iterator[Track]:
    """The motions of obstacles that move by the time, in the node of the world."""
    for number, obstacle in enumerate(obstacles):
        if obstacle.motion is not None:
            path = _obstacle_node(world, number, obstacle)
            poses = np.array([pin.SE3ToXYZQUAT(placed) for placed in obstacle.placements(times)])
            yield Track(path, "position", times, poses[:, :3])
            yield Track(path, "quaternion", times, poses[:, 3:])


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


def _flat_sides(vertices: Array, faces: Indices) -> MeshPart:
    """Triangles that have no corner in common, so that edges are seen."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    numbers = np.arange(faces.size).reshape(-1, 3)
    return MeshPart(corners.reshape(-1, 3), numbers, np.repeat(normals, 3, axis=0), None, None)
