"""Path constraints and via points of a problem while it is made: which there are, in order, and where."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeAlias

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.problem.contact_bounds import ContactBounds, contact_bounds
from mbocp.problem.contact_force import ContactForce
from mbocp.problem.goals.goal import Goal
from mbocp.problem.limits import Bounds
from mbocp.problem.path import PathConstraint
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.sequence import Horizon
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.problem.timeline.via import ViaConstraint, ViaPoint
from mbocp.problem.timeline.via_nodes import placed, via_nodes, via_order
from mbocp.problem.timeline.via_points import resolved_points, via_constraints
from mbocp.problem.warn import warn_singular
from mbocp.robot import Robot
from mbocp.terms import BoundedTerm, OwnPathConstraint, OwnTerm, frame_tolerances

PathObject: TypeAlias = BoundedTerm


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
    path: Sequence[PathObject], terms: Sequence[OwnTerm], goal: Goal, robot: Robot
) -> tuple[PathObject, ...]:
    """Return path constraints of frames and forces, then one's own, then the goal's tolerances."""
    frames = (constraint for constraint in path if isinstance(constraint, PathConstraint))
    asked = (contact for contact in path if isinstance(contact, ContactForce | ContactBounds))
    own = (OwnPathConstraint(term, robot) for term in terms if term.role == "path")
    return (*frames, *asked, *own, *frame_tolerances(goal.frames, robot))


def with_contacts(
    path: Sequence[PathObject], robot: Robot, scheme: str, switches: SwitchTable | None
) -> tuple[PathObject, ...]:
    """Return path constraints whose bounds of forces know the rows of constraints that they bound."""
    asked = [one for one in path if isinstance(one, ContactForce | ContactBounds)]
    found = iter(contact_bounds(asked, robot, scheme, switches))
    return tuple(next(found) if isinstance(one, ContactForce | ContactBounds) else one for one in path)


def ordered_via(
    robot: Robot,
    via: Sequence[ViaPoint],
    phases: Sequence[Phase],
    horizon: Horizon,
    q_start: Array,
    limits: Bounds,
) -> tuple[tuple[ViaPoint, ...], list[int | None]]:
    """Return via points in the order of the motion, with configurations; their nodes, as far as known."""
    nodes = via_nodes(via, horizon, phases)
    order = via_order(via, nodes)
    found = resolved_points(robot, [via[i] for i in order], q_start, limits)
    for point in found:
        warn_singular(robot, point.goal.q, f"via {point.name!r}")
    return found, [nodes[i] for i in order]


def placed_via(
    robot: Robot,
    via: Sequence[ViaPoint],
    nodes: Sequence[int | None],
    q_start: Array,
    goal: Goal,
    num_steps: int,
) -> tuple[ViaConstraint, ...]:
    """Return via points as path constraints at their nodes; those of free times are spread along the way."""
    is_asked = goal.says_where or not via
    at = placed(robot, via, nodes, q_start, goal.q if is_asked else via[-1].goal.q, num_steps)
    return via_constraints(robot, via, at, num_steps)
