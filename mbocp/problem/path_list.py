"""Path constraints of a problem while it is made: which there are, in order."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from mbocp.exceptions import ProblemError
from mbocp.problem.contact_bounds import ContactBounds, contact_bounds
from mbocp.problem.contact_force import ContactForce
from mbocp.problem.goals.goal import Goal
from mbocp.problem.path import PathConstraint
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.robot import Robot
from mbocp.terms import BoundedTerm, OwnPathConstraint, OwnTerm, frame_tolerances


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
