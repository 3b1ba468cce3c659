"""What of a problem does not go together, and its path constraints while it is made, in order."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from mbocp._warn import warn_caller
from mbocp.exceptions import ProblemError
from mbocp.problem._checks import ProblemWarning
from mbocp.problem.contact_bounds import ContactBounds, contact_bounds
from mbocp.problem.contact_force import ContactForce
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.cost import Cost
from mbocp.problem.goals.goal import Goal
from mbocp.problem.guess import Guess
from mbocp.problem.path import PathConstraint
from mbocp.problem.solver import SolverOptions
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.robot import Robot
from mbocp.solvers.options import BOUNDED_METHODS
from mbocp.terms import BoundedTerm, OwnPathConstraint, OwnTerm, frame_tolerances


def check_has_actuators(robot: Robot) -> None:
    """Refuse a robot that nothing drives.

    Raises
    ------
    ProblemError
    """
    if robot.nu == 0:
        raise ProblemError(
            f"robot: {robot.name!r} has no actuator; name the driven joints in robot.actuated "
            "(a free-flyer's root_joint takes a wrench), or write actuators into a robot.toml; its "
            f"joints, all passive: {', '.join(robot.joint_names)}"
        )


def check_guess(guess: Guess, robot: Robot, coordinates: str) -> None:
    """Refuse a guess that does not fit the robot or the coordinates.

    Raises
    ------
    DimensionMismatch, ProblemError
    """
    guess.check_dimensions(robot.nq, robot.nu)
    if guess.kind == "joint" and not COORDINATES[coordinates].takes_joint_guess:
        raise ProblemError('guess.kind: "joint" is for coordinates = "natural"; take another, or "auto"')


def check_weights(cost: Cost, goal: Goal, *, is_free: bool, has_more: bool) -> None:
    """Refuse a terminal weight without a penalty and the other way round; say which weights do nothing.

    Parameters
    ----------
    is_free : bool
        Whether the duration is free.
    has_more : bool
        Whether the problem asks for more than the goal: terms of one's own, via points.
    """
    if goal.is_penalised and cost.terminal == 0.0:
        reason = f'goal.enforce = "{goal.enforce}" needs a weight above 0, got 0'
        raise ProblemError(f"cost.terminal: {reason}")
    if cost.terminal > 0.0 and not goal.is_penalised:
        meant = "both" if goal.is_exact else "penalty"
        raise ProblemError(
            f'cost.terminal: got {cost.terminal:g}, which goal.enforce = "{goal.enforce}" does not use; '
            f'say enforce = "{meant}", or terminal = 0'
        )
    if np.any(cost.weight("time")) and not is_free:
        warn_caller(
            "cost.time: the duration is given, so that its weight adds a constant; "
            "horizon.duration = {min, max} sets it free",
            ProblemWarning,
        )
    if goal.enforce == "none" and cost.tracking == 0.0 and not has_more:
        warn_caller(
            "the problem asks for nothing: no goal is enforced and nothing is tracked, so u = 0 is best",
            ProblemWarning,
        )


def check_method(solver: SolverOptions, table: str, *, is_free: bool, has_free_times: bool) -> None:
    """Refuse a method that keeps no inequalities.

    Parameters
    ----------
    table : str
        The table of the problem file with the inequalities; empty where there are none but the bounds of a
        free duration.
    is_free : bool
        Whether the duration is free.
    has_free_times : bool
        Whether times of via points are.
    """
    if solver.method not in BOUNDED_METHODS:
        able = " | ".join(f'"{method}"' for method in BOUNDED_METHODS)
        cannot, remedy = f"keep [{table}]", f"leave out [{table}]"
        if is_free:
            cannot, remedy = "find a free duration", "give horizon.duration as a number"
        elif has_free_times:
            cannot, remedy = "find a free time of [via]", "give the time as a number"
        raise ProblemError(
            f'solver.method: got "{solver.method}", which cannot {cannot}; take {able}, or {remedy}'
        )
    if solver.is_pure_newton:
        cannot = "finds no free duration" if is_free else "keeps neither [limits] nor [path]"
        raise ProblemError(
            f'solver.globalisation: got "none", with which Newton\'s method {cannot}; take "default"'
        )


def checked_terms(terms: Iterable[OwnTerm], robot: Robot) -> tuple[OwnTerm, ...]:
    """Return terms of one's own that fit the robot and have names of their own.

    Raises
    ------
    ProblemError
    """
    found = tuple(terms)
    names = [term.name for term in found]
    for term in found:
        if names.count(term.name) > 1:
            raise ProblemError(f"terms: there are several of the name {term.name!r}; give each its own")
        term.check(robot)
    return found


def listed_path(
    path: Sequence[BoundedTerm], terms: Sequence[OwnTerm], goal: Goal, robot: Robot
) -> tuple[BoundedTerm, ...]:
    """Return path constraints of frames and forces, then one's own, then the goal's tolerances."""
    frames = (constraint for constraint in path if isinstance(constraint, PathConstraint))
    asked = (contact for contact in path if isinstance(contact, ContactForce | ContactBounds))
    own = (OwnPathConstraint(term, robot) for term in terms if term.role == "path")
    return (*frames, *asked, *own, *frame_tolerances(goal.frames, robot))


def with_contacts(
    path: Sequence[BoundedTerm], robot: Robot, scheme: str, switches: SwitchTable | None
) -> tuple[BoundedTerm, ...]:
    """Return path constraints whose bounds of forces know the rows of constraints that they bound."""
    asked = [one for one in path if isinstance(one, ContactForce | ContactBounds)]
    found = iter(contact_bounds(asked, robot, scheme, switches))
    return tuple(next(found) if isinstance(one, ContactForce | ContactBounds) else one for one in path)
