"""What a problem says of configurations that are allowed and that may not be meant."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise

import numpy as np

from mbocp._arrays import Array
from mbocp._text import list_names, warn_caller
from mbocp._tolerances import BOUND_TOLERANCE
from mbocp.integrators import SCHEMES
from mbocp.problem._checks import ProblemWarning
from mbocp.problem.goals.goal import Goal
from mbocp.problem.limits import Bounds, ask_degrees, with_question
from mbocp.problem.path import PathConstraint
from mbocp.problem.timeline.hold import Hold
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.timeline import Timeline
from mbocp.robot import Robot
from mbocp.robot.kinematics import WORLD
from mbocp.robot.loops.redundancy import singular_pose

_BESIDE = (
    "the solver may stop at such a singular configuration, and the mechanism go on from it in another "
    "assembly mode: give a pose beside it"
)


def warn_singular(robot: Robot, q: Array, key: str) -> None:
    """Say that a mechanism is where it may go on in several ways."""
    words = singular_pose(robot, q)
    if words:
        warn_caller(f"{key}: {words}; {_BESIDE}", ProblemWarning)


def warn_alternating(path: Iterable[PathConstraint], goal: Goal, scheme: str, timeline: Timeline) -> None:
    """Say that equations at all nodes and a velocity at the end are too much for schemes of mean velocities.

    With q1 - q0 = dt (v0 + v1) / 2 the velocity across the equations is minus the one before, at each node.
    So it is known at the end but for the curvature, and to ask for it once more is nearly dependent.
    """
    if not (SCHEMES[scheme].alternates and goal.is_exact and goal.rate_active.any()):
        return
    for constraint in path:
        if has_equations_throughout(constraint, timeline.num_steps, timeline.dt):
            warn_caller(
                f"path {constraint.name!r}: equations at all nodes, and a velocity at the end; "
                f'integrator.scheme = "{scheme}" moves by mean velocities, so that those across the '
                "equations alternate from node to node, and solvers converge slowly or not; take scheme = "
                '"se1", or a tolerance',
                ProblemWarning,
            )


def has_equations_throughout(constraint: PathConstraint, num_steps: int, dt: float) -> bool:
    """Whether a frame keeps equations on its position or orientation at all nodes."""
    term, span = constraint.term, constraint.span
    is_equation = np.asarray(constraint.lower) == np.asarray(constraint.upper)
    is_equation[list(term.rows_with_progress)] = False
    always = span.has_start and span.has_end(num_steps, dt)
    return bool(always and is_equation.any() and not term.has_velocity)


def warn_held_anywhere(robot: Robot, timeline: Timeline, path: Iterable[PathConstraint]) -> None:
    """Say which points are held by the world from the middle of a motion on, wherever they are then.

    Feet of which nothing else is said land in the air, or below the ground.
    """
    asked = {node for waypoint in timeline.waypoints for node in (waypoint.node, waypoint.node + 1)}
    constraints = [(one.frame, one.nodes(timeline.num_steps, timeline.dt)) for one in path]
    anywhere = []
    for node, phase, hold in _points_put_down(timeline):
        frame = robot.frame_id(hold.frame)
        if node not in asked and not any(at == frame and nodes[node - 1].any() for at, nodes in constraints):
            anywhere.append(f"{hold.name} in {phase.name}")
    if anywhere:
        warn_caller(
            f"points are held wherever they are then, in the air, too: {list_names(anywhere, 4)}; say where: "
            "by [ground] and contacts, or by a via point or path constraint at the end of the phase before",
            ProblemWarning,
        )


def _points_put_down(timeline: Timeline) -> Iterator[tuple[int, Phase, Hold]]:
    """Points that the world holds where they are from a phase on, with the node at which it begins."""
    for before, phase in pairwise(timeline.phases):
        known = {held.hold for held in before.holds}
        for hold in (held.hold for held in phase.holds if held.hold not in known):
            if hold.kind == "point" and hold.to == WORLD and hold.at == "where_it_is":
                yield before.last, phase, hold


def warn_limits(robot: Robot, bounds: Bounds, q: Array, key: str) -> None:
    """Say which coordinates are outside limits of the robot that nobody enforces, or look like degrees."""
    if bounds.finite("q").any():
        return
    limits = robot.limits
    lower, upper = limits.position_lower - BOUND_TOLERANCE, limits.position_upper + BOUND_TOLERANCE
    asked = (
        f"{label.name}: {words}"
        for value, low, high, label in zip(q, lower, upper, robot.q_labels, strict=True)
        if (words := ask_degrees(value, low, high, label.unit))
    )
    question = next(asked, "")
    outside = (q < lower) | (q > upper)
    if outside.any():
        names = ", ".join(robot.q_labels[i].name for i in np.flatnonzero(outside))
        message = f"{key}: outside the position limits of {names}; limits are not enforced"
        warn_caller(with_question(message, question), ProblemWarning)
    elif question:
        warn_caller(f"{key}: {question}", ProblemWarning)
