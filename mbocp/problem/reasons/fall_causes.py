"""Floating robots that nothing holds or pushes: their centre of mass flies on a parabola."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.problem.problem import Problem
from mbocp.problem.reasons.cause import Cause
from mbocp.robot import Robot
from mbocp.robot.joints import joint_kind
from mbocp.robot.large import working_data

_ROUND_OFF = 1e-6  # [m, m/s]


def fall_causes(problem: Problem) -> Iterator[Cause]:
    """Goals beside the parabola, in place or in speed: whatever motors do within the robot."""
    root = _flying_root(problem)
    goal = problem.goal
    if root is None or not goal.is_exact or goal.periodic is not None or problem.start_free is not None:
        return
    robot, gravity = problem.robot, np.array(problem.robot.model.gravity.linear)
    data, name = working_data(robot.model), robot.model.names[root]
    pin.centerOfMass(robot.model, data, np.array(problem.q_start), np.array(problem.v_start))
    c0, rate = data.com[0].copy(), data.vcom[0].copy()
    nothing = (
        f"nothing pushes the base of {robot.name} ({name} has no motor): its centre of mass flies on its own"
    )
    # Steps of first order miss the parabola by half a step.
    late = float(np.linalg.norm(gravity)) * problem.dt
    place = _place_at_goal(problem, root)
    if place is not None and problem.duration_range is None:
        T = problem.duration
        flown = c0 + rate * T + 0.5 * gravity * T**2
        missed = float(np.linalg.norm(place[0] - flown)) - place[1]
        if missed > late * T + _ROUND_OFF:
            least = "" if place[1] == 0.0 else "at least "
            line = f"{nothing}, and is {least}{missed:.3g} m from where the goal has it after {T:.4g} s"
            yield Cause("fall", name, line, True, 1.0 + missed)
            return
    if goal.rate_active.all() and not goal.value.any():
        T = _best_time(problem, rate, gravity)
        speed = float(np.linalg.norm(rate + gravity * T))
        if speed > late + _ROUND_OFF:
            line = f"{nothing}, at {speed:.3g} m/s after {T:.4g} s, and the goal has it at rest"
            yield Cause("fall", name, line, True, 1.0 + speed)


def _place_at_goal(problem: Problem, root: int) -> tuple[Array, float] | None:
    """Where the goal has the centre of mass, and how far from there it may be [m]; None: anywhere.

    A goal of the base alone leaves the rest of the robot free, as far as that reaches.
    """
    robot, goal = problem.robot, problem.goal
    model, q = robot.model, np.array(goal.q)
    entry = model.joints[root]
    if goal.q_active.all():
        return pin.centerOfMass(model, working_data(model), q).copy(), 0.0
    if not goal.q_active[entry.idx_v : entry.idx_v + entry.nv].all():
        return None
    masses = np.array([inertia.mass for inertia in model.inertias[1:]])
    reaches = np.array([_reach_of_mass(robot, joint) for joint in range(1, model.njoints)])
    return q[entry.idx_q : entry.idx_q + 3], float(masses @ reaches / masses.sum())


def _reach_of_mass(robot: Robot, joint: int) -> float:
    """How far a body's centre of mass can be from its floating base [m]."""
    model = robot.model
    reach = float(np.linalg.norm(model.inertias[joint].lever))
    for one in [j for j in model.supports[joint] if j != 0][1:]:
        entry, kind = model.joints[one], joint_kind(model, one)
        reach += float(np.linalg.norm(model.jointPlacements[one].translation))
        if kind.word == "prismatic":
            ends = robot.limits.position_lower[entry.idx_q], robot.limits.position_upper[entry.idx_q]
            reach += float(np.max(np.abs(ends)))
        elif kind.word not in ("revolute", "continuous", "spherical"):
            return math.inf
    return reach


def _flying_root(problem: Problem) -> int | None:
    """Joint of the one base that floats, if nothing holds or pushes the robot."""
    robot = problem.robot
    roots = [j for j in range(1, robot.model.njoints) if robot.model.parents[j] == 0]
    if len(roots) != 1 or joint_kind(robot.model, roots[0]).word != "floating":
        return None
    own = robot.model.joints[roots[0]]
    where = slice(own.idx_v, own.idx_v + own.nv)
    is_pushed = robot.actuation.frame_actuators or robot.actuation.selection[where].any()
    is_held = (
        robot.nc or robot.forces or robot.drives or problem.timeline.switches is not None or problem.phase
    )
    return None if is_pushed or is_held else int(roots[0])


def _best_time(problem: Problem, rate: Array, gravity: Array) -> float:
    """Of the durations that may be, the one at which the centre of mass is slowest [s]."""
    least, most = problem.duration_range or (problem.duration, problem.duration)
    size = float(gravity @ gravity)
    turns = -float(rate @ gravity) / size if size else least
    return float(np.clip(turns, least, most))
