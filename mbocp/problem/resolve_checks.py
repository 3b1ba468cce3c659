"""Steps of `mbocp.problem.resolve` that refuse what does not fit together, and give no value."""

from __future__ import annotations

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.problem.coordinate_checks import check_coordinates
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.cost import Cost
from mbocp.problem.goals.free_start import FreeStart, check_free_start, check_periodic
from mbocp.problem.goals.goal import Goal
from mbocp.problem.integration import Stabilisation, check_control_terms, check_controls, check_integrator
from mbocp.problem.limits import Bounds, check_limits, check_mean_squares
from mbocp.problem.obstacles.clearance import Clearance
from mbocp.problem.parameter import Parameter
from mbocp.problem.path import PathConstraint, check_path
from mbocp.problem.rates import check_rates
from mbocp.problem.solver import SolverOptions
from mbocp.problem.timeline.cycle import check_cycle
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.phase_values import heaviest_cost, limits_along
from mbocp.problem.timeline.steps import AskedNodes, check_takes_steps
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.problem.timeline.timeline import Timeline
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.together import check_has_actuators, check_method
from mbocp.problem.warn import warn_alternating, warn_held_anywhere
from mbocp.robot import Robot
from mbocp.robot.named_numbers import take
from mbocp.terms import BoundedTerm, OwnTerm


def check_scheme(
    robot: Robot,
    scheme: str,
    scheme_reason: str,
    lie: str,
    substeps: int,
    stabilisation: Stabilisation,
    controls: str,
) -> None:
    """Refuse options that the scheme does not use, and robots that it cannot integrate."""
    check_integrator(robot, scheme, lie, substeps, stabilisation, suits=scheme_reason)
    check_controls(controls, scheme)
    check_has_actuators(robot)


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


def check_natural(
    robot: Robot,
    coordinates: str,
    scheme: str,
    widest: Bounds,
    said_goal: Goal,
    said_via: tuple[ViaPoint, ...],
    phase: tuple[Phase, ...],
) -> None:
    """Refuse what natural coordinates cannot have."""
    is_free = any(part.is_free for part in phase)
    check_coordinates(robot, coordinates, scheme, widest, said_goal, via=said_via, is_free=is_free)


def check_ends_of_motion(
    robot: Robot,
    coordinates: str,
    start_free: FreeStart | None,
    goal: Goal,
    q_start: Array,
    v_start: Array,
    limits_at_start: Bounds,
    switches: SwitchTable | None,
) -> None:
    """Refuse a free start, and a periodic motion, where they do not fit the rest."""
    check_periodic(robot, goal, coordinates)
    if switches is not None:
        check_cycle(switches, start_free, goal.periodic, (q_start, goal.q))
    if start_free is not None:
        state = (q_start, v_start)
        check_free_start(
            robot, start_free, limits_at_start, state, coordinates=coordinates, switches=switches
        )


def check_steps(
    timeline: Timeline,
    accuracy: float | None,
    coordinates: str,
    path: tuple[BoundedTerm, ...],
    terms: tuple[OwnTerm, ...],
    said_cost: Cost,
) -> None:
    """Refuse lengths of steps, and an accuracy, where others say which steps there are."""
    check_takes_steps(
        AskedNodes.of(timeline, path, terms),
        accuracy,
        timeline.given_lengths,
        coordinates,
        is_switched=timeline.switches is not None,
        has_targets=said_cost.is_trajectory,
    )


def check_inequalities(
    robot: Robot,
    scheme: str,
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
    check_rates(robot, limits)
    check_mean_squares(robot, limits)
    heaviest = heaviest_cost(cost, timeline.phases, robot)
    check_control_terms(controls, heaviest, widest, limits_along(limits, timeline.phases)["u"])
    check_limits(robot, limits_at_start, q_start, v_start, goal, of_end=limits_at_end)
    num_steps, dt, num_lengths = timeline.num_steps, timeline.dt, timeline.num_lengths
    check_path(robot, path, q_start, v_start, goal, num_steps=num_steps, dt=dt, num_lengths=num_lengths)
    frames = [one for one in path if isinstance(one, PathConstraint)]
    warn_alternating(frames, goal, scheme, num_steps=num_steps, dt=dt)
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
    if widest.any_finite or path or timeline.has_free_lengths or has_bounds or parameter:
        table = (
            "parameter"
            if parameter
            else "limits"
            if widest.any_finite
            else "via"
            if timeline.waypoints
            else "path"
        )
        table = "obstacle" if clearance is not None else table
        is_free = timeline.duration_range is not None
        check_method(solver, table, is_free=is_free, has_free_times=timeline.has_free_times)
