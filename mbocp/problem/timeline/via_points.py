"""From via points as they are said to path constraints: their order, configurations and nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import OverdeterminedGoal, ProblemError, UnreachablePose, reword_errors
from mbocp.mechanisms.completion import complete_goal
from mbocp.problem._checks import MAX_POSITION, MAX_RATE, check_size
from mbocp.problem.goals.end_conditions import check_goal_rate
from mbocp.problem.goals.ends import check_driven_rate, without_driven_velocities
from mbocp.problem.goals.frames import check_frames, with_configuration
from mbocp.problem.goals.goal import Goal
from mbocp.problem.limits import Bounds, check_end_limits
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.sequence import Horizon
from mbocp.problem.timeline.via import ViaConstraint, ViaPoint
from mbocp.problem.timeline.via_nodes import place_via_points, via_nodes, via_order
from mbocp.problem.warn import warn_singular
from mbocp.robot import Robot

_EXACT = 1e-8  # [m, rad]


def order_via(
    robot: Robot,
    said_via: Sequence[ViaPoint],
    phase: Sequence[Phase],
    horizon: Horizon,
    q_start: Array,
    limits: Bounds,
) -> tuple[tuple[ViaPoint, ...], tuple[int | None, ...]]:
    """Return via points in the order of the motion, with configurations; their nodes, as far as known.

    Each configuration is the nearest to the one before.

    Raises
    ------
    UnreachablePose, UnreachableGoal
        If no configuration is there.
    InconsistentStart, ProblemError
        If it asks for what the robot cannot have.
    """
    nodes = via_nodes(said_via, horizon, phase)
    order = via_order(said_via, nodes)
    names, found, q = [point.name for point in said_via], [], q_start
    for point in (said_via[i] for i in order):
        if names.count(point.name) > 1:
            raise ProblemError(f"via {point.name!r}: there are several of this name; give each its own")
        with reword_errors(partial(_put_name, point.name)):
            there = _resolve(robot, point, q, limits)
        found.append(there)
        q = there.goal.q
    for point in found:
        warn_singular(robot, point.goal.q, f"via {point.name!r}")
    return tuple(found), tuple(nodes[i] for i in order)


def place_via(
    robot: Robot,
    via: Sequence[ViaPoint],
    nodes: Sequence[int | None],
    q_start: Array,
    goal: Goal,
    num_steps: int,
) -> tuple[ViaConstraint, ...]:
    """Return via points as path constraints at their nodes; those of free times are spread along the way.

    Raises
    ------
    OverdeterminedGoal
        If a point asks for more than the controls until there can meet.
    """
    if not via:
        return ()
    q_end, found = goal.q if goal.says_where else via[-1].goal.q, []
    at = place_via_points(robot, via, nodes, q_start, q_end, num_steps)
    for node, point in zip(at, via, strict=True):
        there = replace(point, share=node / num_steps) if point.is_free else point  # it says its place
        constraint = ViaConstraint(there, robot, node)
        if constraint.num_equations > node * robot.nu:
            raise OverdeterminedGoal(
                f"via {point.name!r}: {constraint.num_equations} equations at node {node}, but the controls "
                f"until there can meet at most {node * robot.nu}; give it later, or more steps"
            )
        found.append(constraint)
    return tuple(found)


def _resolve(robot: Robot, point: ViaPoint, q_before: Array, limits: Bounds) -> ViaPoint:
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
    goal = without_driven_velocities(robot, _pose(robot, point, goal, q_before, limits))
    goal = replace(goal, q=complete_goal(robot, goal.q, goal.q_active, q_before))
    check_goal_rate(robot, goal)
    check_driven_rate(robot, goal)
    check_end_limits(robot, limits, goal)
    return replace(point, goal=goal)


def _pose(robot: Robot, point: ViaPoint, goal: Goal, q_before: Array, limits: Bounds) -> Goal:
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


def _put_name(name: str, words: str) -> str:
    """Name the via point in the words of an error, which are those of a goal."""
    words = words.replace("goal.frame", f"via {name!r}").replace("goal.", f"via {name!r}: ")
    words = words.replace("the goal", "it")
    return words if words.startswith("via ") else f"via {name!r}: {words}"
