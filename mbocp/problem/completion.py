"""What follows from the fields of a problem while it is made: path constraints, phases, via points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TypeAlias

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.problem.contact_bounds import ContactBounds, contact_bounds
from mbocp.problem.contact_force import ContactForce
from mbocp.problem.cost import Cost
from mbocp.problem.goals.goal import Goal
from mbocp.problem.limits import Bounds
from mbocp.problem.path import PathConstraint, spans_found
from mbocp.problem.timeline.meeting import meetings
from mbocp.problem.timeline.named_phase import (
    Horizon,
    NamedPhase,
    are_alike,
    phase_spans,
    places_by_name,
    with_total,
)
from mbocp.problem.timeline.phase_limits import checked_phases
from mbocp.problem.timeline.phases import Phase, phases_between
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.timeline.via_constraint import ViaConstraint
from mbocp.problem.timeline.via_places import placed, via_marks, via_nodes, via_order
from mbocp.problem.timeline.via_points import resolved_points
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


def spread_phases(
    robot: Robot, phases: Sequence[NamedPhase], limits: Bounds, cost: Cost, horizon: Horizon
) -> tuple[tuple[NamedPhase, ...], tuple[float, float]]:
    """Return phases with durations that sum up to the horizon's, and bounds of the sum [s]."""
    durations, bounds = with_total(phases, horizon)
    pairs = zip(checked_phases(robot, phases, limits, cost), durations, strict=True)
    return tuple(replace(phase, duration=duration) for phase, duration in pairs), bounds


def ordered_via(
    robot: Robot,
    via: Sequence[ViaPoint],
    phases: Sequence[NamedPhase],
    horizon: Horizon,
    q_start: Array,
    limits: Bounds,
) -> tuple[tuple[ViaPoint, ...], list[int | None]]:
    """Return via points in the order of the motion, with configurations; their nodes, as far as known."""
    spans, alike = phase_spans(phases), are_alike(phases)
    length, bounds = horizon.duration, horizon.duration_range
    nodes = via_nodes(via, horizon.steps, length, bounds, phases=spans, are_alike=alike)
    order = via_order(via, nodes)
    found = resolved_points(robot, [via[i] for i in order], q_start, limits)
    for point in found:
        warn_singular(robot, point.goal.q, f"via {point.name!r}")
    return found, [nodes[i] for i in order]


def via_placed(
    robot: Robot,
    via: Sequence[ViaPoint],
    nodes: Sequence[int | None],
    q_start: Array,
    goal: Goal,
    num_steps: int,
) -> tuple[int, ...]:
    """Return the node of each via point; those with free times are spread along the way."""
    is_asked = goal.says_where or not via
    return placed(robot, via, nodes, q_start, goal.q if is_asked else via[-1].goal.q, num_steps)


def with_places(
    path: Sequence[PathObject],
    via: Sequence[ViaConstraint],
    switches: SwitchTable | None,
    phases: Sequence[NamedPhase],
) -> tuple[PathObject, ...]:
    """Return path constraints with the nodes of named places; then via points, then meetings."""
    named = {constraint.name: (constraint.node, constraint.node) for constraint in via}
    met = () if switches is None else meetings(switches)
    return (*spans_found(path, places_by_name(named, phase_spans(phases))), *via, *met)


def phases_of_via(
    via: Sequence[ViaPoint], at: Sequence[int], horizon: Horizon, impacts: Sequence[int]
) -> tuple[Phase, ...]:
    """Return runs of steps between free times of via points; empty where all lengths are given."""
    N, T, bounds = horizon.steps, horizon.duration, horizon.duration_range
    marks = via_marks(via, at, N, T, is_free=bounds is not None)
    if not marks and bounds is None:
        return ()
    return phases_between(marks, N, T, bounds or (T, T), impacts)
