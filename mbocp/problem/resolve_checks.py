"""Steps of `mbocp.problem.resolve` that refuse what does not fit together, and give no value."""

from __future__ import annotations

from collections.abc import Sequence

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.integrators import SCHEMES, schemes_that
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.found_parameter import Parameter, Robust
from mbocp.problem.goals.free_start import FreeStart
from mbocp.problem.goals.goal import Goal
from mbocp.problem.integration import check_control_terms
from mbocp.problem.limits import LIMITS, Bounds, check_limits
from mbocp.problem.obstacles.at_ends import refuse_links_in_each_other
from mbocp.problem.obstacles.clearance import Clearance
from mbocp.problem.path import PathConstraint, check_path
from mbocp.problem.solver import SolverOptions
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.phase_values import heaviest_cost, limits_along
from mbocp.problem.timeline.timeline import Timeline
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.warn import warn_alternating, warn_held_anywhere
from mbocp.problem.weights import Cost
from mbocp.robot import Robot
from mbocp.robot.named_numbers import take
from mbocp.solvers.options import BOUNDED_METHODS
from mbocp.terms.bounded import BoundedTerm
from mbocp.terms.rates import RATE_TERMS


def check_parameters(
    robot: Robot, coordinates: str, parameter: tuple[Parameter, ...], clearance: Clearance | None
) -> None:
    """Refuse parameters in natural coordinates, and places that change near obstacles."""
    if not parameter:
        return
    if not COORDINATES[coordinates].has_joint_states:
        raise ProblemError(f'parameter: numbers of the robot are constants in coordinates = "{coordinates}"')
    moving = [one.name for one in parameter for word in one.words if take(robot, word).moves]
    if moving and clearance is not None:
        raise ProblemError(
            f"parameter: {moving[0]} moves frames, which obstacle and self_collision do not follow yet; "
            "take masses, or springs, or leave these tables out"
        )


def check_robust(robot: Robot, coordinates: str, controls: str, robust: Robust | None) -> None:
    """Refuse robust motions of what has no feedback of (q, v)."""
    if robust is None:
        return
    if robot.drives or not COORDINATES[coordinates].has_joint_states:
        raise ProblemError(
            'robust: states are not (q, v) of the joints, as with coordinates = "natural", and with '
            "controls that prescribe motions"
        )
    if controls == "linear":
        raise ProblemError('robust: controls = "linear" is not supported; take "constant" or "stages"')


def check_inequalities(
    robot: Robot,
    scheme: str,
    coordinates: str,
    controls: str,
    cost: Cost,
    limits: Bounds,
    widest: Bounds,
    limits_at_start: Bounds,
    limits_at_end: Bounds,
    q_start: Array,
    v_start: Array,
    goal: Goal,
    timeline: Timeline,
    path: tuple[BoundedTerm, ...],
) -> None:
    """Refuse limits and path constraints that cannot hold."""
    heaviest = heaviest_cost(cost, timeline.phases, robot)
    check_control_terms(controls, heaviest, widest, limits_along(limits, timeline.phases)["u"])
    check_limits(robot, limits_at_start, q_start, v_start, goal, of_end=limits_at_end)
    check_path(robot, path, q_start, v_start, goal, timeline)
    for one in path:
        if isinstance(one, Clearance):
            refuse_links_in_each_other(one, q_start, goal)
    frames = [one for one in path if isinstance(one, PathConstraint)]
    for one in frames:
        if "acceleration" not in one.term.remembers:
            continue
        if robot.drives or not COORDINATES[coordinates].has_joint_states:
            raise ProblemError(
                f"path {one.name!r}: accelerations of joints are those of joint coordinates, and of robots "
                'whose controls are forces and torques; leave it out, or take coordinates = "joint"'
            )
    warn_alternating(frames, goal, scheme, timeline)
    warn_held_anywhere(robot, timeline, frames)


def check_solver(
    solver: SolverOptions,
    widest: Bounds,
    path: tuple[BoundedTerm, ...],
    timeline: Timeline,
    clearance: Clearance | None,
    start_free: FreeStart | None,
    parameter: tuple[Parameter, ...],
) -> None:
    """Refuse a method that would not keep what is to be kept."""
    has_bounds = start_free is not None and start_free.is_bounded
    if not (widest.any_finite or path or timeline.has_free_lengths or has_bounds or parameter):
        return
    others = "via" if timeline.waypoints else "path"
    table = "parameter" if parameter else "limits" if widest.any_finite else others
    table = "obstacle" if clearance is not None else table
    is_free, has_free_times = timeline.duration_range is not None, timeline.has_free_times
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


def check_coordinates(
    robot: Robot,
    coordinates: str,
    scheme: str,
    widest: Bounds,
    said_goal: Goal,
    said_via: tuple[ViaPoint, ...],
    phase: tuple[Phase, ...],
) -> None:
    """Refuse, by name, options that natural coordinates do not have.

    Raises
    ------
    ProblemError
        For explicit schemes, limits on joints, velocities of frames that are not zero, states of joints at
        via points, and where durations are free.
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
        _check_lengths(said_via, is_free=any(part.is_free for part in phase))
    _check_goal(said_goal)
    _check_via(said_via)
    if not data.limits_joints:
        _check_limits(widest)


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
