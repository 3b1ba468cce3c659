"""What of a goal can be moved by hand on a page: poses of frames and bodies, and single joints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp.interactive.resolver import Wish
from mbocp.problem import Goal, Problem
from mbocp.robot import Robot
from mbocp.view.meshcat.goals import goal_placements

_FURTHEST = 2.0 * np.pi  # [rad, m] from the goal, where a joint has no limits
_FREE = (True, True, True)

Moved: TypeAlias = Callable[[Wish, pin.SE3, Array], Wish]


@dataclass(frozen=True, eq=False)
class PoseHandle:
    """A pose that can be dragged.

    Attributes
    ----------
    name : str
        Of what is dragged.
    axes : tuple of bool
        Along which axes of its own it moves.
    slides, turns : bool
        Whether its origin moves, and whether it turns.
    placement : callable
        Its pose in the world, as pin.SE3, from a goal and a configuration at it.
    move : callable
        The wish for it to be elsewhere: from a wish, a pose and a configuration at the goal.
    """

    name: str
    axes: tuple[bool, bool, bool]
    slides: bool
    turns: bool
    placement: Callable[[Goal, Array], pin.SE3]
    move: Moved


@dataclass(frozen=True, eq=False)
class JointHandle:
    """A joint of the goal with one degree of freedom.

    Attributes
    ----------
    name : str
    lower, upper : float
        Between which values it can be [rad, m].
    value : callable
        Its value at a configuration.
    move : callable
        A configuration with another value of it.
    """

    name: str
    lower: float
    upper: float
    value: Callable[[Array], float]
    move: Callable[[Array, float], Array]


def pose_handles(problem: Problem) -> list[PoseHandle]:
    """Poses that the goal asks for; of a goal in joints the bodies that move freely, or else the tool."""
    if problem.goals or problem.goal.periodic is not None or problem.goal.enforce == "none":
        return []
    robot, goal = problem.robot, problem.goal
    found = [_of_frame(problem, place) for place, frame in enumerate(goal.frames) if frame.has_pose]
    found += [_of_body(robot, joint) for joint in _find_asked_joints(problem) if _is_body(robot, joint)]
    has_tool = robot.trace_frames and goal.q_active.all() and robot.nv >= _FULL_POSE
    return found or ([_of_tool(robot)] if has_tool else [])


def joint_handles(problem: Problem) -> list[JointHandle]:
    """Joints that the goal gives a value."""
    if problem.goals:
        return []
    robot = problem.robot
    return [_of_joint(problem, name) for name in _find_asked_joints(problem) if _joint(robot, name).nv == 1]


_FULL_POSE = 6  # velocities without which a tool cannot be anywhere, however turned


def _find_asked_joints(problem: Problem) -> list[str]:
    robot, active = problem.robot, problem.goal.q_active
    names = [name for name in robot.joint_names if _joint(robot, name).nv > 0]
    return [name for name in names if active[robot.velocity_indices(name)].all()]


def _joint(robot: Robot, name: str) -> pin.JointModel:
    return robot.model.joints[robot.model.getJointId(name)]


def _is_body(robot: Robot, joint: str) -> bool:
    return _joint(robot, joint).nv in (3, 6) and _stands(robot, joint)


def _stands(robot: Robot, name: str) -> bool:
    """Whether a joint's pose is its own: it moves in the world, and its configuration is a pose."""
    joint = robot.model.getJointId(name)
    kinds = ("JointModelFreeFlyer", "JointModelPlanar")
    return int(robot.model.parents[joint]) == 0 and robot.model.joints[joint].shortname() in kinds


def _of_frame(problem: Problem, place: int) -> PoseHandle:
    target, robot = problem.goal.frames[place].target, problem.robot
    turns = target.orientation is not None or target.axis is not None
    x, y, z = (k in target.coordinates for k in range(3))
    in_world = not turns and target.relative_to == "world"  # its axes are the world's

    def placement(goal: Goal, q: Array) -> pin.SE3:
        (found,) = goal_placements(robot, [goal.frames[place].target], q)
        return pin.SE3(np.eye(3), found.translation) if in_world else found

    def move(wish: Wish, pose: pin.SE3, _: Array) -> Wish:
        return replace(wish, poses={**wish.poses, place: pose})

    axes = (x, y, z) if in_world else _FREE
    return PoseHandle(target.name, axes, target.coordinates.size > 0, turns, placement, move)


def _of_body(robot: Robot, name: str) -> PoseHandle:
    joint, at = robot.model.getJointId(name), robot.configuration_indices(name)
    base, is_planar = robot.model.jointPlacements[joint], _joint(robot, name).nv == 3

    def placement(_: Goal, q: Array) -> pin.SE3:
        if is_planar:
            x, y, cosine, sine = q[at]
            turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
            return base * pin.SE3(turn, np.array([x, y, 0.0]))
        return base * pin.XYZQUATToSE3(np.array(q[at]))

    def move(wish: Wish, pose: pin.SE3, q: Array) -> Wish:
        own, there = base.actInv(pose), np.array(q)
        if is_planar:
            cosine, sine = own.rotation[:2, 0] / np.linalg.norm(own.rotation[:2, 0])
            there[at] = [*own.translation[:2], cosine, sine]
        else:
            there[at] = pin.SE3ToXYZQUAT(own)
        return replace(wish, q=there, tool=None)

    axes = (True, True, not is_planar)
    return PoseHandle(name, axes, True, True, placement, move)


def _of_tool(robot: Robot) -> PoseHandle:
    name = robot.trace_frames[0]

    def placement(_: Goal, q: Array) -> pin.SE3:
        return robot.frame_placement(name, q)

    def move(wish: Wish, pose: pin.SE3, _: Array) -> Wish:
        return replace(wish, q=None, tool=pose)

    return PoseHandle(name, _FREE, True, True, placement, move)


def _of_joint(problem: Problem, name: str) -> JointHandle:
    robot = problem.robot
    at, is_circle = robot.configuration_indices(name), _joint(robot, name).nq == 2

    def value(q: Array) -> float:
        own = q[at]
        return float(np.arctan2(own[1], own[0]) if is_circle else own[0])

    def move(q: Array, number: float) -> Array:
        there = np.array(q)
        there[at] = [np.cos(number), np.sin(number)] if is_circle else [number]
        return there

    present = value(problem.goal.q)
    if is_circle:
        return JointHandle(name, -np.pi, np.pi, value, move)
    lower, upper = (float(side[at][0]) for side in (robot.limits.position_lower, robot.limits.position_upper))
    lower, upper = max(lower, present - _FURTHEST), min(upper, present + _FURTHEST)
    return JointHandle(name, min(lower, present), max(upper, present), value, move)
