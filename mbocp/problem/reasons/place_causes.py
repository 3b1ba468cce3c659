"""Places that a problem asks for and forbids at once, or that no pose reaches; each is a proof."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations

import numpy as np

from mbocp._arrays import Array
from mbocp.problem.path import PathConstraint
from mbocp.problem.problem import Problem
from mbocp.problem.reasons.cause import Cause
from mbocp.problem.timeline.via import ViaConstraint
from mbocp.robot import Robot
from mbocp.robot.joints import joint_kind

_SLACK = 1e-6  # [m, m/s, rad] by which bounds may miss each other
_AXES = "xyz"


def place_causes(problem: Problem) -> Iterator[Cause]:
    """Path constraints that exclude each other, a via point or all poses, and obstacles at via points."""
    yield from _contradictions(problem)
    for path in problem.frame_constraints:
        if path.kind == "position" and path.other is None:
            yield from _out_of_reach(problem.robot, path)
    if not problem.timeline.has_free_times:
        for point in problem.timeline.waypoints:
            yield from _at_via_point(problem, point)


def _contradictions(problem: Problem) -> Iterator[Cause]:
    """Two constraints of the same thing that hold at the same node, with no value between their bounds."""
    N, dt = problem.num_steps, problem.dt
    for a, b in combinations(problem.frame_constraints, 2):
        if a.kind not in ("position", "distance", "speed", "angular_speed") or not _are_alike(a, b):
            continue
        if not (a.span.nodes(N, dt) & b.span.nodes(N, dt)).any():
            continue
        for i, j, name in _common_rows(a, b):
            low, high = max(a.lower[i], b.lower[j]), min(a.upper[i], b.upper[j])
            if low > high + _SLACK:
                unit = a.labels[i].unit
                frame = problem.robot.model.frames[a.frame].name
                words = (
                    f"paths {a.name!r} and {b.name!r} exclude each other: {name} of {frame} would be at "
                    f"least {low:.4g} {unit} and at most {high:.4g} {unit}"
                )
                yield Cause("contradiction", a.name, words, True, 1.0 + low - high)


def _are_alike(a: PathConstraint, b: PathConstraint) -> bool:
    same = (a.kind, a.frame, a.other) == (b.kind, b.frame, b.other)
    return same and bool(np.array_equal(a.point, b.point))


def _common_rows(a: PathConstraint, b: PathConstraint) -> Iterator[tuple[int, int, str]]:
    if a.kind != "position":
        yield 0, 0, a.kind.replace("_", " ")
        return
    for i, axis in enumerate(a.axes):
        if axis in b.axes:
            yield i, b.axes.index(axis), _AXES[axis]


def _out_of_reach(robot: Robot, path: PathConstraint) -> Iterator[Cause]:
    """A box that a frame cannot get to, for its links are too short all together."""
    center, reach = _ball(robot, path.frame)
    at = center[list(path.axes)]
    away = float(np.linalg.norm(np.fmax(np.fmax(path.lower - at, at - path.upper), 0.0)))
    if away > reach + _SLACK:
        frame = robot.model.frames[path.frame].name
        words = (
            f"path {path.name!r}: {frame} would have to be {away:.4g} m from the base of {robot.name}, and "
            f"its links reach {reach:.4g} m"
        )
        yield Cause("reach", path.name, words, True, away / max(reach, _SLACK))


def _ball(robot: Robot, frame: int) -> tuple[Array, float]:
    """Centre, shape (3,), and radius of a ball that a frame cannot leave [m]; infinite for a moving base."""
    model = robot.model
    shown = model.frames[frame]
    chain = [j for j in model.supports[shown.parentJoint] if j != 0]
    if not chain:
        return np.array(shown.placement.translation), 0.0
    reach = float(np.linalg.norm(shown.placement.translation))
    reach += sum(float(np.linalg.norm(model.jointPlacements[j].translation)) for j in chain[1:])
    for j in chain:
        kind = joint_kind(model, j)
        if kind.word == "prismatic":
            q = model.joints[j].idx_q
            ends = robot.limits.position_lower[q], robot.limits.position_upper[q]
            reach += float(np.max(np.abs(ends)))
        elif kind.word not in ("revolute", "continuous", "spherical"):
            return np.zeros(3), math.inf
    return np.array(model.jointPlacements[chain[0]].translation), reach


def _at_via_point(problem: Problem, point: ViaConstraint) -> Iterator[Cause]:
    """Constraints and obstacles that a via point's configuration does not meet."""
    goal, robot = point.via.goal, problem.robot
    if not goal.q_active.all() or point.node < 1:
        return
    still, where = np.zeros(robot.nv), f"via {point.name!r}"
    for path in problem.frame_constraints:
        holds = path.span.nodes(problem.num_steps, problem.dt)[point.node - 1]
        if not holds or path.term.has_velocity or path.structure("quaternion").remembers:
            continue
        values = path.values(robot, goal.q, still)
        over = np.fmax(values - path.upper, path.lower - values)
        i = int(np.argmax(over))
        if over[i] > _SLACK:
            label, above = path.labels[i], values[i] > path.upper[i]
            side, bound = ("above", path.upper[i]) if above else ("below", path.lower[i])
            words = (
                f"path {path.name!r}: at {where} {label.name} is {values[i]:.4g} {label.unit}, {side} its "
                f"bound {bound:.4g}"
            )
            yield Cause("via", path.name, words, True, 1.0 + float(over[i]))
    clearance = problem.clearance
    if clearance is not None and clearance.rows:
        values = clearance.values(robot, goal.q, still)
        if (values < clearance.lower - _SLACK).any():
            words = clearance.refusal(values, where)
            yield Cause("via", point.name, words, True, 1.0)
