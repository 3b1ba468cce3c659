"""Robots as they are drawn, and faintly: the same one in other poses, and others that move beside it.

Joints without a mesh are a stick figure: balls at joints, rods from each joint to the next.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp._text import warn_caller
from mbocp.exceptions import ReplayError
from mbocp.robot import Robot
from mbocp.robot.payload import shape_name
from mbocp.view.meshcat.commands import (
    Command,
    Track,
    colour_number,
    mg,
    set_object,
    set_transform,
    shape_object,
)
from mbocp.view.meshcat.shapes import tube
from mbocp.view.meshcat.visuals import MeshLibrary
from mbocp.view.motion_samples import PlacementSamples

_OPACITY = 0.35
_OTHER_OPACITY = 0.55
_BALL, _ROD = 0xD9822B, 0x5B7FA6  # of joints without a mesh
COLOURS = {  # of other motions, told apart by people with any colour vision
    "orange": (0.90, 0.45, 0.05),
    "blue": (0.10, 0.45, 0.80),
    "green": (0.05, 0.60, 0.45),
    "pink": (0.80, 0.40, 0.65),
}


@dataclass(frozen=True)
class Other:
    """A motion of another result, shown at the same time.

    Attributes
    ----------
    robot : Robot
    motion : PlacementSamples
    name : str
        What it is called on the page.
    """

    robot: Robot
    motion: PlacementSamples
    name: str


def ghost_points(robot: Robot, poses: Sequence[PlacementSamples]) -> list[Array]:
    """Places of the joints in each pose, shape (1, 3) each [m], for the camera."""
    return [pose.positions[0, joint][None, :] for pose in poses for joint in range(1, robot.model.njoints)]


def path_points(motion: PlacementSamples) -> Array:
    """Places of all joints along a motion, shape (K, 3) [m], for the camera."""
    return np.asarray(motion.positions[:, 1:].reshape(-1, 3))


def ghost_commands(robot: Robot, poses: Sequence[PlacementSamples], root: str) -> Iterator[Command]:
    """Draw the robot, faint, in each of the poses.

    Parameters
    ----------
    robot : Robot
    poses : sequence of PlacementSamples
        Each of one pose.
    root : str
        Node under which they are drawn.
    """
    library = MeshLibrary(robot)
    for k, pose in enumerate(poses):
        yield from _copy(robot, library, pose, f"{root}/ghost_{k}", {"opacity": _OPACITY})


def other_commands(others: Sequence[Other], root: str) -> Iterator[Command]:
    """Draw other robots at the start of their motions, each in a colour of its own."""
    for k, (other, colour) in enumerate(zip(others, COLOURS.values(), strict=False)):
        paint = {
            "opacity": _OTHER_OPACITY,
            "color": colour_number(colour),
            "map": None,
            "vertexColors": False,
        }
        yield from _copy(other.robot, MeshLibrary(other.robot), other.motion, f"{root}/other_{k}", paint)


def other_tracks(others: Sequence[Other], root: str) -> Iterator[Track]:
    """Their motions."""
    for k, other in enumerate(others):
        yield from joint_tracks(other.motion, partial(_node, f"{root}/other_{k}"))


def joint_tracks(motion: PlacementSamples, node: Callable[[int], str]) -> Iterator[Track]:
    """The motion of each joint, at its node."""
    for joint in range(1, motion.model.njoints):
        if motion.moves(joint):
            yield Track(node(joint), "position", motion.times, motion.positions[:, joint])
            yield Track(node(joint), "quaternion", motion.times, motion.quaternions[:, joint])


def robot_commands(
    robot: Robot,
    library: MeshLibrary,
    motion: PlacementSamples,
    node: Callable[[int], str],
    *,
    is_copy: bool = False,
) -> tuple[list[Command], dict[int, list[Array]]]:
    """Commands that draw a robot at its first pose, and the corners that each joint carries along.

    Parameters
    ----------
    robot : Robot
    library : MeshLibrary
        Its meshes.
    motion : PlacementSamples
    node : callable
        Path of a joint's node by the index of the joint.
    is_copy : bool
        Whether the robot is drawn already: what stands still is left out, and nothing is told twice.
    """
    commands = [
        set_transform(node(joint), motion.rotations[0, joint], motion.positions[0, joint])
        for joint in range(motion.model.njoints)
    ]
    corners: dict[int, list[Array]] = {}
    missing = joints_without_visuals(robot)
    for index, visual in enumerate(robot.visual_model.geometryObjects):
        joint = visual.parentJoint
        if is_copy and joint == 0:
            continue
        path = f"{node(joint)}/{index}_{visual.name.replace('/', '|')}"
        try:
            drawn = library.draw(visual)
        except ReplayError as error:
            if not is_copy:
                warn_caller(f"{error}; its joint is drawn as a stick")
            missing.add(joint)
            continue
        commands.append(set_object(path, drawn))
        commands.append(set_transform(path, visual.placement.rotation, visual.placement.translation))
        corners.setdefault(joint, []).append(library.corners(visual))
    for joint, sticks, points in skeleton(motion.model, missing):
        commands += [set_object(f"{node(joint)}/stick_{i}", stick) for i, stick in enumerate(sticks)]
        corners.setdefault(joint, []).append(points)
    return commands, corners


def _copy(
    robot: Robot, library: MeshLibrary, motion: PlacementSamples, root: str, paint: dict[str, Any]
) -> Iterator[Command]:
    """Draw a robot at the first pose of a motion, in materials that are painted over."""
    commands, _ = robot_commands(robot, library, motion, partial(_node, root), is_copy=True)
    for command in commands:
        drawn = command.message.get("object")
        yield command if drawn is None else set_object(command.message["path"], _paint(drawn, paint))


def _node(root: str, joint: int) -> str:
    return f"{root}/joint_{joint}"


def _paint(drawn: dict[str, Any], paint: dict[str, Any]) -> dict[str, Any]:
    """The same object with materials that one sees through."""
    materials = []
    for material in drawn.get("materials", ()):
        opacity = paint["opacity"] * float(np.clip(material.get("opacity", 1.0), 0, 1))
        changed = {**material, **paint, "transparent": True, "opacity": opacity}
        materials.append({key: value for key, value in changed.items() if value is not None})
    return {**drawn, "materials": materials}


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
