"""Places that a problem asks for and forbids at once, or that no motion reaches."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.problem.obstacles.clear_goal import clearest
from mbocp.problem.path import PathConstraint
from mbocp.problem.problem import Problem
from mbocp.problem.reasons.cause import Cause
from mbocp.problem.timeline.via import ViaConstraint
from mbocp.robot import Robot
from mbocp.robot.joints import joint_kind
from mbocp.robot.kinematics import length_of, reach
from mbocp.robot.large import make_working_data

_SLACK = 1e-6  # [m, m/s, rad] by which bounds may miss each other
_AXES = "xyz"


def place_causes(problem: Problem) -> Iterator[Cause]:
    """Path constraints that exclude each other, a via point or all poses; what is in the way at places."""
    yield from _contradictions(problem)
    for path in problem.frame_constraints:
        if path.kind == "position" and path.other is None:
            yield from _out_of_reach(problem.robot, path)
    if not problem.timeline.has_free_times:
        for point in problem.timeline.waypoints:
            yield from _at_via_point(problem, point)
    yield from _at_goal(problem)


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
    frame, limits = robot.model.frames[path.frame], robot.limits
    ends = limits.position_lower, limits.position_upper
    center, radius = reach(robot.model, frame.parentJoint, frame.placement.translation, *ends)
    at = center[list(path.axes)]
    away = float(np.linalg.norm(np.fmax(np.fmax(path.lower - at, at - path.upper), 0.0)))
    if away > radius + _SLACK:
        words = (
            f"path {path.name!r}: {frame.name} would have to be {away:.4g} m from the base of {robot.name}, "
            f"and its links reach {radius:.4g} m"
        )
        yield Cause("reach", path.name, words, True, away / max(radius, _SLACK))


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


def _at_goal(problem: Problem) -> Iterator[Cause]:
    """Obstacles in the way at all configurations that are found at a goal of frames; there may be others."""
    clearance, goal, robot = problem.clearance, problem.goal, problem.robot
    if clearance is None or clearance.movers or not clearance.rows or clearance.least(goal.q[None])[0] >= 0.0:
        return
    q, room, count = clearest(robot, goal, problem.q_start, problem.limits_of_ends[1], clearance)
    if not room < -_SLACK:
        return
    frame = goal.poses[0].name
    place = ", ".join(f"{x:.4g}" for x in robot.frame_placement(frame, q).translation)
    joints = ", ".join(f"{c.name} {x:.4g} {c.unit}".rstrip() for c, x in zip(robot.q_labels, q, strict=True))
    words = (
        f"{clearance.refusal(clearance.values(robot, q, np.zeros(robot.nv)), 'goal')}; of {count} "
        f"configurations that bring {frame} there this is in it least: {joints}, {frame} at ({place}) m"
    )
    yield Cause("goal", frame, words, False, 1.0 - room)


def fall_causes(problem: Problem) -> Iterator[Cause]:
    """Goals beside the parabola on which a robot that nothing holds or pushes flies, in place or in speed."""
    root = _find_flying_root(problem)
    goal = problem.goal
    if root is None or not goal.is_exact or goal.periodic is not None or problem.start_free is not None:
        return
    robot, gravity = problem.robot, np.array(problem.robot.model.gravity.linear)
    data, name = make_working_data(robot.model), robot.model.names[root]
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
        if missed > late * T + _SLACK:
            least = "" if place[1] == 0.0 else "at least "
            line = f"{nothing}, and is {least}{missed:.3g} m from where the goal has it after {T:.4g} s"
            yield Cause("fall", name, line, True, 1.0 + missed)
            return
    if goal.rate_active.all() and not goal.value.any():
        T = _best_time(problem, rate, gravity)
        speed = float(np.linalg.norm(rate + gravity * T))
        if speed > late + _SLACK:
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
        return pin.centerOfMass(model, make_working_data(model), q).copy(), 0.0
    if not goal.q_active[entry.idx_v : entry.idx_v + entry.nv].all():
        return None
    masses = np.array([inertia.mass for inertia in model.inertias[1:]])
    levers = [float(np.linalg.norm(inertia.lever)) for inertia in model.inertias[1:]]
    ends = robot.limits.position_lower, robot.limits.position_upper
    chains = [length_of(model, list(support)[2:], *ends) for support in model.supports[1:]]
    reaches = np.array(levers) + chains
    return q[entry.idx_q : entry.idx_q + 3], float(masses @ reaches / masses.sum())


def _find_flying_root(problem: Problem) -> int | None:
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
