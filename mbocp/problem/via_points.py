"""From via points to path constraints: their nodes, and configurations that are there."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue, MbocpError, OverdeterminedGoal, ProblemError, UnreachablePose
from mbocp.mechanisms.completion import complete_goal
from mbocp.problem._checks import MAX_POSITION, MAX_RATE, ProblemWarning, check_size
from mbocp.problem.consistency import check_goal_rate
from mbocp.problem.drives import check_driven_rate, without_driven_velocities
from mbocp.problem.frames import check_frames, with_configuration
from mbocp.problem.goal import Goal
from mbocp.problem.limits import Bounds, check_end_limits
from mbocp.problem.via import ViaPoint
from mbocp.problem.via_constraint import ViaConstraint
from mbocp.robot import Robot

__all__ = ["via_constraints", "via_nodes"]

_ON_NODE = 1e-6  # of a step
_EXACT = 1e-8  # [m, rad]
_STACK = 5  # from a warning to the caller of `Problem`


def via_nodes(via: Sequence[ViaPoint], num_steps: int, duration: float, *, is_free: bool) -> tuple[int, ...]:
    """The node of each via point, the nearest to its time.

    Parameters
    ----------
    duration : float
        [s]
    is_free : bool
        Whether the duration is found with the motion.

    Raises
    ------
    InvalidValue, ProblemError
        If a time is outside the horizon, nearest to its start or end, or the time of another via point.
    """
    found: list[int] = []
    for point in via:
        key = f"via {point.name!r}"
        if point.is_free:
            raise ProblemError(f"{key}: when is it? Give time or share")
        if point.time is not None and is_free:
            raise ProblemError(
                f"{key}: time is one of a given duration, and this one is free; give share, or "
                "horizon.duration as a number"
            )
        if point.time is not None and point.time > duration:
            raise InvalidValue(f"{key}: time", point.time, f"a time within the horizon of {duration:g} s")
        share = point.share if point.share is not None else point.time / duration  # type: ignore[operator]
        node = round(share * num_steps)
        if not 0 < node < num_steps:
            where = "start" if node == 0 else "end"
            raise ProblemError(
                f"{key}: the nearest node is the {where} of the motion; say it in "
                f"{'start' if node == 0 else 'goal'}, or take more steps"
            )
        if node in found:
            raise ProblemError(
                f"{key}: at node {node}, as via {via[found.index(node)].name!r}; say both in one, or take "
                "another time"
            )
        if abs(node - share * num_steps) > _ON_NODE:
            at = f"share {node / num_steps:.6g}" if is_free else f"t = {node * duration / num_steps:.6g} s"
            warnings.warn(
                f"{key}: between two nodes; it holds at the nearest one, {at}",
                ProblemWarning,
                stacklevel=_STACK,
            )
        found.append(node)
    return tuple(found)


def via_constraints(
    robot: Robot, via: Sequence[ViaPoint], nodes: Sequence[int], q_start: Array, limits: Bounds
) -> tuple[ViaConstraint, ...]:
    """Path constraints in the order of their nodes, each with the configuration nearest to the one before.

    Raises
    ------
    UnreachablePose, UnreachableGoal
        If no configuration is there.
    InconsistentStart, OverdeterminedGoal, ProblemError
        If it asks for what the robot cannot have, or for more than its controls can meet.
    """
    names = [point.name for point in via]
    found, q = [], q_start
    for node, point in sorted(zip(nodes, via, strict=True), key=lambda pair: pair[0]):
        if names.count(point.name) > 1:
            raise ProblemError(f"via {point.name!r}: there are several of this name; give each its own")
        with _named(point.name):
            there = _resolved(robot, point, q, limits)
        constraint = ViaConstraint(there, robot, node)
        if constraint.num_equations > node * robot.nu:
            raise OverdeterminedGoal(
                f"via {point.name!r}: {constraint.num_equations} equations at node {node}, but the controls "
                f"until there can meet at most {node * robot.nu}; give it later, or more steps"
            )
        found.append(constraint)
        q = there.goal.q
    return tuple(found)


def _resolved(robot: Robot, point: ViaPoint, q_before: Array, limits: Bounds) -> ViaPoint:
    goal = point.goal
    goal.check_dimensions(robot.nq, robot.nv)
    base = np.array(q_before)
    for joint in robot.joint_names:
        if goal.q_active[robot.velocity_indices(joint)].any():
            base[robot.configuration_indices(joint)] = goal.q[robot.configuration_indices(joint)]
    goal = replace(goal, q=robot.normalise(base, name="goal.q"))
    check_size("goal.q", goal.q, robot.q_labels, MAX_POSITION)
    check_size("goal.v", goal.value, robot.v_labels, MAX_RATE)
    check_frames(robot, goal)
    goal = without_driven_velocities(robot, _posed(robot, point, goal, q_before, limits))
    goal = replace(goal, q=complete_goal(robot, goal.q, goal.q_active, q_before))
    check_goal_rate(robot, goal)
    check_driven_rate(robot, goal)
    check_end_limits(robot, limits, goal)
    return replace(point, goal=goal)


def _posed(robot: Robot, point: ViaPoint, goal: Goal, q_before: Array, limits: Bounds) -> Goal:
    """With a configuration at the poses of the frames, or within their tolerances."""
    try:
        return with_configuration(robot, goal, q_before, limits)
    except UnreachablePose as error:
        nearest = replace(goal, q=error.q)
        has_tolerance = any(frame.has_tolerance for frame in goal.frames)
        if not (has_tolerance and _is_within(robot, point, nearest)):
            raise
        return nearest


def _is_within(robot: Robot, point: ViaPoint, goal: Goal) -> bool:
    """Whether every frame is within its tolerances at goal.q."""
    constraint = ViaConstraint(replace(point, goal=goal), robot, 1)
    lower, upper = constraint.lower - _EXACT, constraint.upper + _EXACT
    values = constraint.values(robot, goal.q, np.zeros(robot.nv))
    speaks_of_pose = np.ones(constraint.rows, dtype=np.bool_)
    first = constraint.term.num_pose
    speaks_of_pose[first : first + constraint.term.num_rate] = False
    is_inside = (values >= lower) & (values <= upper)
    return bool(is_inside[speaks_of_pose].all())


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Name the via point in every error from the block, whose words are those of a goal."""
    try:
        yield
    except MbocpError as error:
        words = str(error).replace("goal.frame", f"via {name!r}").replace("goal.", f"via {name!r}: ")
        words = words.replace("the goal", "it")
        error.args = (words if words.startswith("via ") else f"via {name!r}: {words}",)
        raise
