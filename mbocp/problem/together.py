"""What of a problem does not go together, and its path constraints while it is made, in order."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from mbocp._text import warn_caller
from mbocp.exceptions import ProblemError
from mbocp.problem._checks import ProblemWarning
from mbocp.problem.contact_bounds import ContactBounds, check_has_forces, contact_bounds, force_rows
from mbocp.problem.contact_force import ContactForce
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.goals.goal import Goal
from mbocp.problem.path import PathConstraint
from mbocp.problem.solver import Guess
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.phase_values import is_weighed
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.weights import Cost
from mbocp.robot import Robot
from mbocp.terms import OwnTerm
from mbocp.terms.bounded import BoundedTerm
from mbocp.terms.frame_tolerance import frame_tolerances
from mbocp.terms.own_parts import OwnPathConstraint


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


def check_weights(
    cost: Cost,
    goal: Goal,
    terms: tuple[OwnTerm, ...],
    said_via: tuple[ViaPoint, ...],
    phase: tuple[Phase, ...],
    duration_range: tuple[float, float] | None,
    robot: Robot,
    scheme: str,
    switches: SwitchTable | None,
) -> None:
    """Refuse a terminal weight without a penalty and the other way round; say which weights do nothing.

    Refuse weights on forces of constraints where there are none, too.
    """
    if is_weighed(key := "constraint_force", cost, phase):
        check_has_forces(f"cost.{key}", scheme)
        if not robot.nc and switches is None:
            raise ProblemError(
                f"cost.{key}: robot {robot.name!r} has no constraints, and nothing is held; leave it out"
            )
    force_rows(terms, robot, scheme, switches)  # refuses forces that are not there
    if goal.is_penalised and cost.terminal == 0.0:
        reason = f'goal.enforce = "{goal.enforce}" needs a weight above 0, got 0'
        raise ProblemError(f"cost.terminal: {reason}")
    if cost.terminal > 0.0 and not goal.is_penalised:
        meant = "both" if goal.is_exact else "penalty"
        raise ProblemError(
            f'cost.terminal: got {cost.terminal:g}, which goal.enforce = "{goal.enforce}" does not use; '
            f'say enforce = "{meant}", or terminal = 0'
        )
    is_free = duration_range is not None or any("time" in part.weights for part in phase)
    if np.any(cost.weight("time")) and not is_free:
        warn_caller(
            "cost.time: the duration is given, so that its weight adds a constant; "
            "horizon.duration = {min, max} sets it free",
            ProblemWarning,
        )
    if goal.enforce == "none" and cost.tracking == 0.0 and not (terms or said_via):
        warn_caller(
            "the problem asks for nothing: no goal is enforced and nothing is tracked, so u = 0 is best",
            ProblemWarning,
        )


def check_terms(
    said_terms: Iterable[OwnTerm], said_path: Sequence[BoundedTerm], said_goal: Goal, robot: Robot
) -> tuple[tuple[OwnTerm, ...], tuple[BoundedTerm, ...]]:
    """Return terms of one's own that fit the robot and have names of their own, and all path constraints.

    Those of frames and forces come first, then one's own, then the goal's tolerances.

    Raises
    ------
    ProblemError
    """
    terms = tuple(said_terms)
    names = [term.name for term in terms]
    for term in terms:
        if names.count(term.name) > 1:
            raise ProblemError(f"terms: there are several of the name {term.name!r}; give each its own")
        term.check(robot)
    frames = (constraint for constraint in said_path if isinstance(constraint, PathConstraint))
    asked = (contact for contact in said_path if isinstance(contact, ContactForce | ContactBounds))
    own = (OwnPathConstraint(term, robot) for term in terms if term.role == "path")
    return terms, (*frames, *asked, *own, *frame_tolerances(said_goal.frames, robot))


def with_contacts(
    path: Sequence[BoundedTerm], robot: Robot, scheme: str, switches: SwitchTable | None
) -> tuple[BoundedTerm, ...]:
    """Return path constraints whose bounds of forces know the rows of constraints that they bound."""
    asked = [one for one in path if isinstance(one, ContactForce | ContactBounds)]
    found = iter(contact_bounds(asked, robot, scheme, switches))
    return tuple(next(found) if isinstance(one, ContactForce | ContactBounds) else one for one in path)
