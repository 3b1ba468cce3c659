"""Refusal of what natural coordinates cannot have."""

from __future__ import annotations

from collections.abc import Sequence

from mbocp.exceptions import ProblemError
from mbocp.integrators import SCHEMES, schemes_that
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.goals.goal import Goal
from mbocp.problem.limits import LIMITS, Bounds
from mbocp.problem.timeline.via import ViaPoint
from mbocp.robot import Robot
from mbocp.terms import RATE_TERMS


def check_coordinates(
    robot: Robot,
    coordinates: str,
    scheme: str,
    limits: Bounds,
    goal: Goal,
    *,
    via: Sequence[ViaPoint] = (),
    is_free: bool = False,
) -> None:
    """Refuse, by name, options that natural coordinates do not have.

    Raises
    ------
    ProblemError
        For explicit schemes, limits on joints, velocities of frames that are not zero, states of joints at
        via points, and where the duration `is_free`.
    UnsupportedRobot
        For joints that natural coordinates do not know.
    """
    data = COORDINATES[coordinates]
    if data.needs_constraints and not SCHEMES[scheme].takes_natural:
        raise ProblemError(
            f'integrator.scheme: got "{scheme}", but natural coordinates are tied by constraints, which are '
            f"solved with each step by {schemes_that(lambda data: data.takes_natural)} alone; take one of "
            'these, or coordinates = "joint"'
        )
    if data.limits_joints and data.takes_free_duration:
        return
    if robot.elastic:
        raise ProblemError('coordinates: "natural" knows no elastic joints; take "joint"')
    from mbocp.mechanics import natural_mechanics  # joint coordinates do not need them

    if not natural_mechanics(robot).tree.turning:
        return  # the same as joint coordinates
    if not data.takes_free_duration:
        _check_lengths(via, is_free=is_free)
    _check_goal(goal)
    _check_via(via)
    if not data.limits_joints:
        _check_limits(limits)


def _check_lengths(via: Sequence[ViaPoint], *, is_free: bool) -> None:
    if is_free:
        raise ProblemError(
            "horizon.duration, or that of a phase: natural coordinates take steps of a given length; give a "
            'number, or take coordinates = "joint"'
        )
    for point in via:
        if point.is_free:
            raise ProblemError(
                f"via {point.name!r}: time: natural coordinates take steps of a given length; give the "
                'time as a number, or share, or take coordinates = "joint"'
            )


def _check_goal(goal: Goal) -> None:
    for frame in goal.frames:
        if frame.rates.any():
            raise ProblemError(
                f"goal.frame: a velocity of {frame.name!r}, but in natural coordinates velocities of bodies "
                'are those over a step: take 0, which is rest in any case, or coordinates = "joint"'
            )
    if goal.a_active.any() and goal.a_rule == "given":
        raise ProblemError(
            "goal.a: natural coordinates have no accelerations of joints; leave it out, or take "
            'coordinates = "joint"'
        )


def _check_via(via: Sequence[ViaPoint]) -> None:
    for point in via:
        asked = point.goal
        if asked.q_active.any() or asked.rate_active.any() or any(frame.rates.size for frame in asked.frames):
            raise ProblemError(
                f"via {point.name!r}: natural coordinates have no joint positions and velocities; give "
                'poses of frames, or take coordinates = "joint"'
            )


def _check_limits(limits: Bounds) -> None:
    for letter in ("q", "v", *(term.letter for term in RATE_TERMS.values() if term.needs_joints)):
        if limits.finite(letter).any():
            raise ProblemError(
                f"{LIMITS[letter]}: natural coordinates have no joint positions and velocities to limit; "
                'take coordinates = "joint", or path constraints'
            )
