"""Names of motions, made of what differs between them: configuration at the goal, turns, sides, swings.

A `Trait` says in a few words what one motion does in one respect. Of all traits in turn those are taken that
tell motions apart which the words so far do not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.menus.candidates import box_around, tool_of
from mbocp.problem import Problem
from mbocp.robot import Robot
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.robot.joints import joint_kind, velocity_slice
from mbocp.robot.nodes import steps_between
from mbocp.solution import Solution

Trait: TypeAlias = Callable[[Solution], str]

_UPRIGHT = math.cos(math.radians(30.0))  # axes that are as near to the vertical turn left and right
_OFFSET = 0.01  # [m] of a shoulder beside the base's axis, that one can see
_SINGULAR = 0.05  # sine of an angle below which nobody sees which way a wrist is turned
_MANY = 7  # joints of an arm whose elbow is free to go around
_SMALL = 0.15  # [rad, m], or as a part of the farthest: a swing that is smaller does not count
_EARLIER = 0.08  # of the duration, by which one joint goes first


def names_of_motions(problem: Problem, solutions: Sequence[Solution]) -> list[str]:
    """A name for each motion; the same motions have the same names, whatever their order."""
    if len(solutions) == 1:
        return ["the only one"]
    groups = [list(range(len(solutions)))]  # of motions with the same words
    words: list[list[str]] = [[] for _ in solutions]
    for trait in _traits(problem, solutions):
        groups = [part for group in groups for part in _split(group, trait, solutions, words)]
    names = [", ".join(filter(None, mine)) or "direct" for mine in words]
    seen: dict[str, int] = {}
    for place, name in enumerate(names):
        seen[name] = seen.get(name, 0) + 1
        names[place] = f"{name} ({seen[name]})" if seen[name] > 1 else name
    return names


def _split(
    group: Sequence[int], trait: Trait, solutions: Sequence[Solution], words: Sequence[list[str]]
) -> list[list[int]]:
    """Motions by what a trait says of them, which is added to their words where it tells them apart."""
    parts: dict[str, list[int]] = {}
    for place in group if len(group) > 1 else ():
        parts.setdefault(trait(solutions[place]), []).append(place)
    if len(parts) < 2:
        return [list(group)]
    for said, part in parts.items():
        for place in part:
            words[place].append(said)
    return list(parts.values())


def _traits(problem: Problem, solutions: Sequence[Solution]) -> Iterator[Trait]:
    """What motions may differ in, the most telling first."""
    robot = problem.robot
    if problem.goals:
        yield lambda solution: f"to goal {1 + (solution.goal_place or 0)}"
    for obstacle in problem.obstacle:
        if obstacle.stands:
            yield _Side(problem, obstacle)
    arm = _arm_of(problem)
    if arm is not None and problem.goal.poses:
        yield from (arm.shoulder, arm.elbow, arm.wrist)
    for joint in range(1, robot.model.njoints):
        kind = joint_kind(robot.model, joint)
        if [unit for _, unit in kind.v] == ["rad"]:
            turn = _Turn(robot, joint)
            if turn.differs(solutions):
                yield turn
    yield from (partial(_swing, robot, at) for at in range(robot.nv))
    yield partial(_first, robot)
    yield _Halfway(robot, solutions)


class _Turn:
    """Which way around a joint goes, that ends in the same angle a whole turn apart."""

    def __init__(self, robot: Robot, joint: int) -> None:
        self._robot, self._at = robot, velocity_slice(robot.model, joint)
        self._joint, self._name = joint, _short(robot.model.names[joint])

    def differs(self, solutions: Sequence[Solution]) -> bool:
        """Whether any two of the motions do."""
        found = np.array([self._angle(solution) for solution in solutions])
        turns = np.abs(found[:, None] - found) / (2.0 * np.pi)
        return bool(((turns > 0.5) & (np.abs(turns - turns.round()) < _SINGULAR)).any())

    def __call__(self, solution: Solution) -> str:
        angle = self._angle(solution)
        if self._is_upright(solution.qs[0]):
            return f"{self._name} turns {'left' if angle > 0.0 else 'right'}"
        if abs(abs(angle) - np.pi) < _SINGULAR:
            return f"{self._name} turns {'forwards' if angle > 0.0 else 'backwards'}"
        return f"the long way round in {self._name}" if abs(angle) > np.pi else ""

    def _angle(self, solution: Solution) -> float:
        return float(steps_between(self._robot, solution.qs)[:, self._at].sum())

    def _is_upright(self, q: Array) -> bool:
        """Whether its axis points up; one that points down turns the other way, and is told by its angle."""
        place = _placements(self._robot, q)[self._joint]
        return bool(_axis(place, self._robot.model, self._joint)[2] > _UPRIGHT)


def _swing(robot: Robot, at: int, solution: Solution) -> str:
    """How often a coordinate turns back on its way, and whether it goes away from its goal first."""
    name = _short(robot.v_labels[at].name)
    moved = np.concatenate([[0.0], np.cumsum(steps_between(robot, solution.qs)[:, at])])
    signs = _directions(moved, max(_SMALL, _SMALL * float(np.ptp(moved))))
    if len(signs) < 2:
        return f"{name} straight there" if signs else f"{name} stays"
    way = f"{name} swings {'forwards' if signs[0] > 0 else 'backwards'} first"
    return way if len(signs) == 2 else f"{way}, {len(signs)} swings"


def _directions(values: Array, least: float) -> list[int]:
    """Sign of each swing that is larger than `least`, one after the other."""
    signs, low, high = list[int](), float(values[0]), float(values[0])
    for value in values:
        low, high = min(low, value), max(high, value)
        if value - low > least and (not signs or signs[-1] < 0):
            signs.append(1)
            high = low = value
        elif high - value > least and (not signs or signs[-1] > 0):
            signs.append(-1)
            high = low = value
        elif signs:  # as long as a swing goes on, the next one is measured from its end
            low, high = (high, high) if signs[-1] > 0 and value >= high else (low, high)
            low, high = (low, low) if signs[-1] < 0 and value <= low else (low, high)
    return signs


def _first(robot: Robot, solution: Solution) -> str:
    """Which joint has gone half its way long before the others."""
    moved = np.cumsum(steps_between(robot, solution.qs), axis=0)
    going = np.flatnonzero(np.abs(moved[-1]) > _SMALL)
    if len(going) < 2:
        return ""
    halves = [int(np.argmax(np.abs(moved[:, at]) >= 0.5 * abs(moved[-1, at]))) for at in going]
    order = np.argsort(halves, kind="stable")
    lead = (halves[order[1]] - halves[order[0]]) / len(moved)
    return f"{_short(robot.v_labels[going[order[0]]].name)} first" if lead > _EARLIER else ""


class _Halfway:
    """Where the coordinate is at half time that differs the most between motions."""

    def __init__(self, robot: Robot, solutions: Sequence[Solution]) -> None:
        self._robot = robot
        found = np.array([self._displacement(solution) for solution in solutions])
        self._at = int(np.argmax(np.ptp(found, axis=0)))

    def __call__(self, solution: Solution) -> str:
        label, moved = self._robot.v_labels[self._at], float(self._displacement(solution)[self._at])
        how = f"{moved:+.2f} m" if label.unit == "m/s" else f"{math.degrees(moved):+.0f} deg"
        return f"{_short(label.name)} {how} at half time"

    def _displacement(self, solution: Solution) -> Array:
        half = 1 + int(np.argmin(np.abs(solution.t - 0.5 * (solution.t[0] + solution.t[-1]))))
        return steps_between(self._robot, solution.qs[:half]).sum(axis=0)


class _Side:
    """On which side of an obstacle the tool goes, as seen by who goes with it; "" where it does not pass."""

    def __init__(self, problem: Problem, obstacle: Obstacle) -> None:
        self._robot, self._frame, self._name = problem.robot, tool_of(problem), obstacle.name
        self._centre, self._half = box_around(obstacle)

    def __call__(self, solution: Solution) -> str:
        places = np.array([self._robot.frame_placement(self._frame, q).translation for q in solution.qs])
        ahead = places[-1] - places[0]
        ahead[2] = 0.0
        length = float(np.linalg.norm(ahead))
        if length < 1e-3:
            return ""
        ahead /= length
        along = (places - self._centre) @ ahead
        if along[0] * along[-1] >= 0.0:
            return ""
        beside = places[int(np.argmin(np.abs(along)))] - self._centre
        across = float(beside @ np.array([-ahead[1], ahead[0], 0.0]))
        over = float(beside[2]) / max(float(self._half[2]), _OFFSET)
        if abs(over) > max(1.0, abs(across) / max(float(self._half[:2].max()), _OFFSET)):
            return f"{'over' if over > 0.0 else 'under'} the {self._name}"
        return f"{'left' if across > 0.0 else 'right'} of the {self._name}"


class _Arm:
    """Configurations of an arm at the end of a motion, in the words of its joints: shoulder, elbow, wrist."""

    def __init__(self, robot: Robot, chain: Sequence[int]) -> None:
        self._robot, self._chain = robot, list(chain)
        places = [place.translation for place in _placements(robot, robot.neutral())]
        middle, first, last = self._chain[2:-2], places[chain[1]], places[chain[-2]]
        reach = [min(np.linalg.norm(places[k] - first), np.linalg.norm(last - places[k])) for k in middle]
        self._elbow = middle[int(np.argmax(reach))]

    def shoulder(self, solution: Solution) -> str:
        """On which side of the way from the base to the wrist the shoulder is."""
        side, offset = self._side_of_shoulder(solution.qs[-1])
        if offset > _OFFSET:
            return f"shoulder {'left' if side > 0.0 else 'right'}"
        return (
            "shoulder flipped" if side * self._side_of_shoulder(solution.qs[0])[0] < 0.0 else "shoulder kept"
        )

    def elbow(self, solution: Solution) -> str:
        """Where the elbow is beside the line from the shoulder to the wrist."""
        places = _placements(self._robot, solution.qs[-1])
        first, elbow, last = (places[k].translation for k in (self._chain[1], self._elbow, self._chain[-2]))
        axis = _axis(places[self._elbow], self._robot.model, self._elbow)
        line, out = _across(last - first, axis), _across(elbow - first, axis)
        out = out - line * float(out @ line) / max(float(line @ line), 1e-12)
        upright = f"elbow {'up' if out[2] > 0.0 else 'down'}"
        if len(self._chain) < _MANY:
            return upright
        left = np.cross([0.0, 0.0, 1.0], line)
        left /= max(float(np.linalg.norm(left)), 1e-12)
        aside = float(out @ left)
        if abs(aside) > abs(out[2]):
            return f"elbow {'left' if aside > 0.0 else 'right'}"
        return upright

    def wrist(self, solution: Solution) -> str:
        """Whether the last three axes are in another order around than at the start."""
        start, end = (self._order_of_wrist(solution.qs[k]) for k in (0, -1))
        start = 1.0 if abs(start) < _SINGULAR else start
        return "wrist flipped" if start * end < 0.0 else "wrist kept"

    def _side_of_shoulder(self, q: Array) -> tuple[float, float]:
        """In front of the base or behind it, and how far the shoulder is beside its axis [m]."""
        base, second = self._chain[:2]
        places = _placements(self._robot, q)
        up, across = (_axis(places[k], self._robot.model, k) for k in (base, second))
        wrist = places[self._chain[-2]].translation - places[base].translation
        beside = _across(places[second].translation - places[base].translation, up)
        if np.linalg.norm(beside) <= _OFFSET:
            return float(wrist @ np.cross(across, up)), 0.0
        return float(up @ np.cross(wrist, beside)), float(np.linalg.norm(beside))

    def _order_of_wrist(self, q: Array) -> float:
        places = _placements(self._robot, q)
        return float(np.linalg.det([_axis(places[k], self._robot.model, k) for k in self._chain[-3:]]))


def _arm_of(problem: Problem) -> _Arm | None:
    """The arm that carries the tool: six revolute joints or more in a row; None of other robots."""
    model = problem.robot.model
    chain = [
        k for k in model.supports[model.frames[problem.robot.frame_id(tool_of(problem))].parentJoint] if k
    ]
    is_arm = all(joint_kind(model, k).word in ("revolute", "continuous") for k in chain)
    return _Arm(problem.robot, chain) if len(chain) >= 6 and is_arm else None


def _placements(robot: Robot, q: Array) -> list[pin.SE3]:
    """Placement of each joint in the world."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, np.asarray(q))
    return [pin.SE3(place) for place in data.oMi]


def _axis(place: pin.SE3, model: pin.Model, joint: int) -> Array:
    """Axis of a revolute joint in the world."""
    own = model.joints[joint].createData()
    model.joints[joint].calc(own, pin.neutral(model))
    return place.rotation @ np.asarray(own.S).reshape(6, -1)[3:, 0]


def _across(vector: Array, axis: Array) -> Array:
    """What of a vector is across an axis."""
    return vector - axis * float(vector @ axis)


def _short(joint: str) -> str:
    return joint.removesuffix("_joint")
