"""Ways from start to goal in the configuration space: straight, the other way around, through a third place.

A way gives configurations by their share of it, and begins where it is told: with some schemes the first
step goes where the start velocity says, and the way begins there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray
from mbocp.formulation import Formulation
from mbocp.mechanisms.closed_path import find_closed_path, find_driving_joints, path_towards
from mbocp.mechanisms.consistent_states import project_on_constraints
from mbocp.problem import Problem
from mbocp.problem.goals.frames import RESTARTS, goal_branches
from mbocp.robot import Robot
from mbocp.robot.joints import joint_kind, velocity_slice
from mbocp.robot.nodes import between, interpolate, steps_between
from mbocp.robot.poses.pose_search import inside, joint_bounds

Way: TypeAlias = Callable[[Array, Array], Array]

_FULL_TURN = 2.0 * np.pi
_MIN_ANGLE = 1e-6  # [rad] a smaller rotation has no axis to turn about the other way
_LEG = 0.5  # share of the way at which a way of two legs is in its third place
_NO_LENGTH = 1e-300  # of a way that stays where it is
_SAME_PLACE = 1e-6  # [rad, m] between configurations
_CHECKED = 21  # configurations of a way along which loops have to stay closed
_MAX_TRIES = 6  # to get to a third place with closed loops, each half as far as the one before
_REACH = 0.5  # of the way to a random configuration: halfway there from the middle of the line


def straight(problem: Problem) -> Way:
    """The straight line to the goal, or as near to it as closed loops allow."""
    return straight_to(problem, problem.goal.q)


def straight_to(problem: Problem, q_goal: Array) -> Way:
    """The straight line to a configuration, or as near to it as closed loops allow."""
    return lambda q_start, shares: _on_the_way(problem.robot, q_start, q_goal, shares)


def read_given_way(problem: Problem) -> Way | None:
    """Straight lines through the configurations of `guess.q`, at a steady rate; None where it has none."""
    if problem.guess.q is None:
        return None
    return through(problem.robot, [*problem.guess.q, np.asarray(problem.goal.q)])


def through(robot: Robot, corners: Iterable[Array]) -> Way:
    """Straight lines from where it begins through other configurations, by the share of their length.

    Where loops are closed, as near to the lines as these allow.
    """
    places = list(corners)

    def way(q_start: Array, shares: Array) -> Array:
        corners = np.array([q_start, *places])
        lengths = np.linalg.norm(steps_between(robot, corners), axis=1)
        at = np.append(0.0, np.cumsum(lengths)) / max(float(lengths.sum()), _NO_LENGTH)
        which = np.clip(np.searchsorted(at, shares, side="right") - 1, 0, len(lengths) - 1)
        parts = np.clip((shares - at[which]) / np.maximum(at[which + 1] - at[which], _NO_LENGTH), 0.0, 1.0)
        if not robot.nc:
            return between(robot, corners[which], corners[which + 1], parts)
        legs = enumerate(pairwise(corners))
        found = [_on_the_way(robot, *leg, parts[which == k]) for k, leg in legs if (which == k).any()]
        return np.vstack([np.zeros((0, robot.nq)), *found])

    return way


def branch_ways(problem: Problem, restarts: int = RESTARTS) -> Iterator[tuple[str, Way]]:
    """Straight lines to the other configurations in which frames are at the goal, the nearest first."""
    robot, goal = problem.robot, problem.goal
    if not goal.poses or goal.enforce == "none":
        return
    shares = np.linspace(0.0, 1.0, _CHECKED)
    found = goal_branches(robot, goal, problem.q_start, problem.limits, restarts=restarts)
    for number, q in enumerate(found.branches, start=1):
        if np.abs(robot.difference(goal.q, q)).max() < _SAME_PLACE:
            continue
        if not robot.nc or find_closed_path(robot, problem.q_start, q, shares) is not None:
            yield (
                f"line to configuration {number} of {len(found.branches)} at the goal",
                straight_to(problem, q),
            )


def turn_ways(formulation: Formulation) -> Iterator[tuple[str, Way]]:
    """Ways on which one joint goes the other way around; with words, the shortest first.

    Of joints that are at the goal again after a whole turn, and that nothing limits: those of cosine and
    sine, planar and ball joints, free-flyers; and other revolute ones where the goal does not count turns, as
    poses of frames and natural coordinates do not.
    """
    problem, robot = formulation.problem, formulation.problem.robot
    if robot.nc:
        return
    ahead = robot.difference(problem.q_start, problem.goal.q)
    found = []
    for joint in range(1, robot.model.njoints):
        kind, at = joint_kind(robot.model, joint), velocity_slice(robot.model, joint)
        turns = np.array([unit == "rad" for _, unit in kind.v], dtype=np.bool_)
        if not turns.any() or joint in robot.model.mimicked_joints or not _may_turn(formulation, joint):
            continue
        back = _other_way(ahead[at], turns)
        if back is not None:
            there = ahead.copy()
            there[at] = back
            found.append((float(np.linalg.norm(back[turns])), robot.model.names[joint], there))
    lower, upper = position_limits(problem)
    for _, name, there in sorted(found, key=lambda entry: entry[:2]):
        q_goal = robot.integrate(problem.q_start, there)
        if inside(robot.model, q_goal, lower, upper):
            yield f"line, {name} the other way around", _along(robot, there, q_goal)


def _may_turn(formulation: Formulation, joint: int) -> bool:
    """Whether a joint is at the goal, too, a whole turn from goal.q."""
    problem, at = formulation.problem, velocity_slice(formulation.problem.robot.model, joint)
    kind = joint_kind(problem.robot.model, joint)
    is_free = bool(problem.goal.poses) and not problem.goal.q_active[at].any()
    return not kind.is_vector or (kind.word == "revolute" and (is_free or not formulation.counts_turns))


def position_limits(problem: Problem) -> tuple[Array, Array]:
    """Position limits of the problem; where it has none, those of the robot."""
    limits, of_robot = problem.limits, problem.robot.limits
    if limits.finite("q").any():
        return limits.q_lower, limits.q_upper
    return of_robot.position_lower, of_robot.position_upper


def middle_of_line(problem: Problem) -> Array:
    """The configuration in the middle of the straight line, closed loops closed."""
    return straight(problem)(problem.q_start, np.array([0.0, _LEG, 1.0]))[1]


def random_way(
    problem: Problem, rng: np.random.Generator, reach: float = _REACH, middle: Array | None = None
) -> Way:
    """A way towards a random configuration within the limits, closed loops closed.

    `reach` says how far it goes from the middle of the line, 1 being there; who makes several ways gives them
    the middle, which takes a path of its own where loops are closed.
    """
    robot = problem.robot
    bounds = joint_bounds(robot.model, *position_limits(problem), frozenset())
    middle = middle_of_line(problem) if middle is None else middle
    through = bounds.random(robot.model, bounds.clip(middle), rng)
    if robot.nc:
        return _two_legs(problem, _reach(robot, problem, through))
    aside = reach * robot.difference(middle, through)

    def way(q_start: Array, shares: Array) -> Array:
        line = straight(problem)(q_start, shares)
        bumps = (4.0 * shares * (1.0 - shares)) ** 2  # no velocity aside at both ends, one in the middle
        qs = [robot.integrate(q, bump * aside) for q, bump in zip(line, bumps, strict=True)]
        return np.array([q if s in (0.0, 1.0) else bounds.clip(q) for q, s in zip(qs, shares, strict=True)])

    return way


def _reach(robot: Robot, problem: Problem, through: Array) -> Array:
    """Configuration towards `through` from which the loops can be led to the goal; at worst the start."""
    whole, driving = robot.difference(problem.q_start, through), find_driving_joints(robot, problem.q_start)
    shares = np.linspace(0.0, 1.0, 11)
    for reach in _REACH ** np.arange(1, 1 + _MAX_TRIES):
        target = robot.integrate(problem.q_start, reach * whole)
        path = path_towards(robot, problem.q_start, target, driving, shares)
        if path is not None and find_closed_path(robot, path[-1], problem.goal.q, shares) is not None:
            return path[-1]
    return problem.q_start


def _two_legs(problem: Problem, through: Array) -> Way:
    robot = problem.robot

    def way(q_start: Array, shares: Array) -> Array:
        is_first = shares < _LEG
        legs = [_blend(shares[is_first] / _LEG), _blend((shares[~is_first] - _LEG) / (1.0 - _LEG))]
        there = _on_the_way(robot, q_start, through, np.append(legs[0], 1.0))
        onward = _on_the_way(robot, there[-1], problem.goal.q, legs[1])
        return np.vstack([there[:-1], onward])

    return way


def _blend(shares: Array) -> Array:
    """From rest to rest."""
    return shares**2 * (3.0 - 2.0 * shares)


def _along(robot: Robot, ahead: Array, q_goal: Array) -> Way:
    """Configurations along a velocity that leads to the goal, less what an earlier begin changes of it."""

    def way(q_start: Array, shares: Array) -> Array:
        qs = np.array([robot.integrate(q_start, share * ahead) for share in shares])
        missing = robot.difference(qs[-1], q_goal) if shares[-1] == 1.0 else np.zeros(robot.nv)
        return np.array([robot.integrate(q, s * missing) for q, s in zip(qs, shares, strict=True)])

    return way


def _other_way(ahead: Array, turns: BoolArray) -> Array | None:
    """Displacement of a joint to the same place with its rotation the other way around."""
    angle = float(np.linalg.norm(ahead[turns]))
    if angle < _MIN_ANGLE:
        return None
    back: Array = ahead.copy()
    back[turns] *= 1.0 - _FULL_TURN / angle
    if turns.all():
        return back
    along, about = np.zeros(3), np.zeros(3)  # a screw: the same translation takes another velocity
    along[: int((~turns).sum())], about[-int(turns.sum()) :] = ahead[~turns], ahead[turns]
    translation = pin.exp6(pin.Motion(along, about)).translation
    back[~turns] = np.linalg.solve(pin.Jexp3(-about * (1.0 - _FULL_TURN / angle)), translation)[
        : int((~turns).sum())
    ]
    return back


def _on_the_way(robot: Robot, q_start: Array, q_goal: Array, shares: Array) -> Array:
    """Configurations on the straight line, or as near to it as closed loops allow."""
    every = np.arange(robot.nv)
    if robot.nc:
        way = find_closed_path(robot, project_on_constraints(robot, q_start, every), q_goal, shares)
        if way is not None:
            return way
    qs = interpolate(robot, q_start, q_goal, shares)
    return np.array([project_on_constraints(robot, q, every) for q in qs]) if robot.nc else qs
