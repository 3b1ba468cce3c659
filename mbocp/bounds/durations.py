"""The least duration of a problem: what single joints, forces and frames take at least."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.bounds.speeds import Speeds
from mbocp.bounds.task import BoundTask, Displacements
from mbocp.problem.reasons.least_time import least_time
from mbocp.robot.joints import joint_kind
from mbocp.robot.kinematics import WORLD
from mbocp.terms.frame_goal import FrameGoal

BY_FORCES = "efforts speed joints up no faster"
BY_FRAMES = "joints carry a frame to its goal no faster"
_WINDOWS = 100
_HALVINGS = 40


def least_duration(task: BoundTask, *, is_quick: bool = False) -> tuple[float, str]:
    """Bound the duration from below [s], and say what decides; in a hurry look at joints alone."""
    task = replace(task, reached=math.nan)  # it holds for motions that cost more, too
    labels = task.problem.robot.v_labels
    legs = [_times(task, *pair) for pair in pairwise(task.places)]
    total = sum(float(times.max(initial=0.0)) for times in legs)
    if len(legs) > 1:
        return total, "the slowest joint from via point to via point" if total else ""
    words = f"{labels[int(np.argmax(legs[0]))].name} alone takes that long" if total else ""
    others: tuple[tuple[Callable[[BoundTask, float], float], str], ...] = (
        (_by_forces, BY_FORCES),
        (_by_frames, BY_FRAMES),
    )
    for find, why in others if not is_quick else ():
        if (found := find(task, total)) > total:
            total, words = found, why
    return total, words


def _times(task: BoundTask, begin: Displacements, end: Displacements) -> Array:
    """Least time of each joint alone from one place to the next [s]; 0 where nothing is known."""
    limits, goal, moves = task.problem.widest_limits, task.problem.goal, task.between(begin.q, end.q)
    found = np.zeros(len(moves))
    for i in np.flatnonzero(np.isfinite(moves)):
        speeds = limits.v_upper[i], -limits.v_lower[i]
        still = 0  # ends at which the acceleration is zero
        if len(task.places) == 2:
            still = int(task.problem.a_start[i] == 0.0) + int(goal.a_active[i] and goal.a[i] == 0.0)
        a, j = math.inf, math.inf
        if np.isfinite(begin.v[i]):
            a, j = max(limits.a_upper[i], -limits.a_lower[i]), max(limits.j_upper[i], -limits.j_lower[i])
        found[i] = least_time(
            float(moves[i]),
            float(max(speeds) if task.circles[i] else speeds[int(moves[i] < 0.0)]),
            float(a),
            float(j),
            from_rate=float(np.nan_to_num(begin.v[i])),
            to_rate=None if np.isnan(end.v[i]) else float(end.v[i]),
            still_ends=still,
            is_circle=bool(task.circles[i]),
        )
    return found


def _by_forces(task: BoundTask, least: float) -> float:
    """Least time in which joints come to the goal, whose speeds after the start and before it are bounded."""
    if task.why_no_forces or not np.isfinite(task.forces().sides).any():
        return 0.0
    scale, found = least or _longest(task), 0.0
    # Windows that grow see short times, then equal ones what is near the bound.
    for shares in (np.geomspace(1e-3, 1.5, _WINDOWS), np.linspace(0.0, 1.1, _WINDOWS)[1:]):
        ways = _Ways.of(task, np.append(0.0, scale * shares))
        for i in np.flatnonzero(np.isfinite(task.moves) & ~task.circles):
            found = max(
                found, ways.least_time(abs(float(task.moves[i])), partial(ways.way, int(i), task.moves[i]))
            )
        scale = found or scale
    return found


def _by_frames(task: BoundTask, least: float) -> float:
    """Least time in which a frame gets to its goal, where each joint moves it by its reach at most."""
    goals = [goal for goal in task.problem.goal.frames if goal.target.relative_to == WORLD]
    if not (goals and task.problem.goal.is_exact) or task.problem.parameter:
        return 0.0
    ways = _Ways.of(task, np.append(0.0, _longest(task) * np.geomspace(1e-3, 1.0, _WINDOWS)))
    return max(_by_frame(task, ways, goal) for goal in goals)


def _longest(task: BoundTask) -> float:
    return (task.problem.duration_range or (0.0, task.problem.duration))[1]


def _by_frame(task: BoundTask, ways: _Ways, goal: FrameGoal) -> float:
    robot, target = task.problem.robot, goal.target
    model, frame = robot.model, robot.model.frames[robot.frame_id(goal.name)]
    chain = [int(j) for j in model.supports[frame.parentJoint] if j > 0]
    kinds = [joint_kind(model, j).word for j in chain]
    if not {*kinds} <= {"revolute", "continuous"}:
        return 0.0
    reach: list[float] = []
    out = float(np.linalg.norm(frame.placement.translation))
    for j in reversed(chain):
        reach.insert(0, out)
        out += float(np.linalg.norm(model.jointPlacements[j].translation))
    at, placement = (
        [int(model.joints[j].idx_v) for j in chain],
        robot.frame_placement(goal.name, task.problem.q_start),
    )
    found = 0.0
    if target.position is not None:
        which, slack = target.coordinates, 0.0 if goal.position_tolerance is None else goal.position_tolerance
        away = np.abs(np.array(target.position) - placement.translation) - slack
        distance = float(np.linalg.norm(np.maximum(away[which], 0.0)))
        found = ways.least_time(distance, lambda T: float(np.dot(reach, [ways.farthest(i, T) for i in at])))
    if target.orientation is not None:
        angle = float(np.linalg.norm(pin.log3(placement.rotation.T @ target.rotation)))
        angle -= goal.orientation_tolerance or 0.0
        found = max(found, ways.least_time(angle, lambda T: sum(ways.farthest(i, T) for i in at)))
    return found


class _Ways:
    """How far joints get, at most, whose speeds are bounded from both ends of the motion."""

    def __init__(self, after: Speeds, before: Speeds) -> None:
        self._edges = after.edges
        grow = np.maximum.accumulate
        self._there = grow(after.upper), grow(-after.lower)  # up and down
        self._back = grow(-before.lower), grow(before.upper)

    @classmethod
    def of(cls, task: BoundTask, edges: Array) -> _Ways:
        return cls(*task.speeds(edges))

    def way(self, i: int, sign: float, T: float) -> float:
        """How far a joint gets upwards, or downwards, in a time within the windows [rad, m]."""
        edges = self._edges[self._edges < T]
        marks = np.unique(np.concatenate([edges, T - edges, [T]]))
        middle, side = (marks[1:] + marks[:-1]) / 2.0, int(sign < 0.0)
        there, back = (
            bounds[side][np.searchsorted(self._edges, at) - 1, i]
            for bounds, at in ((self._there, middle), (self._back, T - middle))
        )
        return float(np.sum(np.diff(marks) * np.maximum(np.minimum(there, back), 0.0)))

    def farthest(self, i: int, T: float) -> float:
        """The larger of both ways."""
        return max(self.way(i, 1.0, T), self.way(i, -1.0, T))

    def least_time(self, distance: float, way: Callable[[float], float]) -> float:
        """A time in which a way is shorter than a distance [s], at most the end of the windows."""
        low, high = 0.0, float(self._edges[-1])
        if way(high) < distance:
            return high
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if way(middle) < distance else (low, middle)
        return low
