"""From what is said of a problem to all that follows: the horizon, the scheme, phases, ends, path, checks.

Each step is a function of values by their names: those that start with `said_` are as a file, or a program,
gives them; the others follow, and most are fields of `Problem`. The order is that in which errors are told.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from mbocp._arrays import Array
from mbocp.problem._checks import check_integer
from mbocp.problem.free_contact_bounds import check_free_contacts, free_contacts
from mbocp.problem.goals.ends import check_acceleration, check_start_state, settle_goal
from mbocp.problem.goals.free_start import check_free_start, check_periodic
from mbocp.problem.goals.goal import Goal
from mbocp.problem.integration import check_integrator, choose_scheme
from mbocp.problem.limits import Bounds, check_mean_squares
from mbocp.problem.obstacles.clear_goal import clear_configuration
from mbocp.problem.obstacles.clearance import Clearance, SelfCollision
from mbocp.problem.obstacles.clearance_pairs import clearance_of
from mbocp.problem.pipeline import Step
from mbocp.problem.rate_limits import check_rates
from mbocp.problem.resolve_checks import (
    check_coordinates,
    check_inequalities,
    check_parameters,
    check_robust,
    check_solver,
)
from mbocp.problem.timeline.acting import check_landings, check_schedule, switch_table
from mbocp.problem.timeline.cycle import check_cycle
from mbocp.problem.timeline.hold import Schedule
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.phase_values import fit_phases, limits_of_phases, widest_limits
from mbocp.problem.timeline.sequence import Horizon, schedule_of, spread_phases
from mbocp.problem.timeline.step_counts import AskedNodes, check_accuracy, check_lengths, check_steps
from mbocp.problem.timeline.switches import SwitchTable, contact_conditions
from mbocp.problem.timeline.timeline import ANY_TIME, Condition, Timeline, timeline_of
from mbocp.problem.timeline.times import check_duration
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.timeline.via_points import order_via, place_via
from mbocp.problem.together import check_guess, check_has_actuators, check_terms, check_weights, with_contacts
from mbocp.problem.weights import Cost
from mbocp.robot import Robot
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.terms import OwnTerm
from mbocp.terms.bounded import BoundedTerm

_Range = tuple[float, float] | None


def _duration(said_duration: float, said_duration_range: _Range) -> tuple[float, _Range]:
    return check_duration(said_duration, said_duration_range)


def _steps(
    said_num_steps: int,
    said_lengths: Any,
    said_accuracy: Any,
    said_impacts: Iterable[int],
    said_phase: tuple[Phase, ...],
    said_via: tuple[ViaPoint, ...],
    said_path: tuple[BoundedTerm, ...],
    said_terms: tuple[OwnTerm, ...],
    duration: float,
    duration_range: _Range,
) -> tuple[Horizon, int, Array | None, float | None, tuple[int, ...]]:
    steps = check_integer("horizon.steps", said_num_steps, minimum=1)
    accuracy = check_accuracy(said_accuracy)
    if accuracy is not None and said_lengths is None and not said_phase:
        steps = AskedNodes(duration, duration_range, (), said_via, said_path, said_terms).first_count()
    impacts = tuple(sorted({int(step) for step in said_impacts}))
    lengths = check_lengths(said_lengths, steps, duration)
    return Horizon(steps, duration, duration_range), steps, lengths, accuracy, impacts


def _phase(
    robot: Robot,
    said_phase: tuple[Phase, ...],
    limits: Bounds,
    said_cost: Cost,
    horizon: Horizon,
    schedule: Schedule,
) -> tuple[tuple[Phase, ...], tuple[float, float]]:
    """Spread the duration over the phases; bounds of the sum that those of phases do not imply."""
    if not said_phase:
        N, T, bounds = horizon
        return (Phase(steps=N - len(schedule.impacts), duration=T, duration_range=bounds, last=N),), ANY_TIME
    phases, bounds_of_sum = spread_phases(said_phase, horizon)
    return fit_phases(robot, phases, limits, said_cost), bounds_of_sum


def _limits_of_ends(limits: Bounds, phase: tuple[Phase, ...]) -> tuple[Bounds, Bounds, Bounds]:
    """The widest limits, and those at both ends."""
    each = limits_of_phases(limits, phase)
    return widest_limits(limits, phase), each[0], each[-1]


def _start(
    robot: Robot, limits_at_start: Bounds, said_q_start: Array, said_v_start: Array, said_a_start: Array
) -> tuple[Array, Array, Array]:
    q, v = check_start_state(robot, limits_at_start, said_q_start, said_v_start)
    return q, v, check_acceleration(robot, limits_at_start, said_a_start)


def _find_active_rows(
    robot: Robot,
    scheme: str,
    coordinates: str,
    num_steps: int,
    schedule: Schedule,
    q_start: Array,
    v_start: Array,
    path_of_frames: tuple[BoundedTerm, ...],
) -> tuple[SwitchTable | None, tuple[BoundedTerm, ...]]:
    """Find which rows of constraints act in which steps, and whose forces are bounded."""
    table = None
    if not schedule.is_empty:
        check_schedule(robot, scheme, coordinates, num_steps, schedule)
        table = switch_table(robot, schedule, num_steps, (q_start, v_start))
        check_landings(table, coordinates)
    path = with_contacts(path_of_frames, robot, scheme, table)
    return table, (*path, *free_contacts(robot, q_start, table, path))


def _timeline(
    robot: Robot,
    via_in_order: tuple[ViaPoint, ...],
    nodes_of_via: tuple[int | None, ...],
    q_start: Array,
    goal_at_pose: Goal,
    horizon: Horizon,
    lengths: Array | None,
    phase: tuple[Phase, ...],
    bounds_of_sum: tuple[float, float],
    switches: SwitchTable | None,
    path_with_contacts: tuple[BoundedTerm, ...],
) -> tuple[Timeline, tuple[BoundedTerm, ...]]:
    """Find nodes of via points, and times that are free; what holds at junctions comes last in the path."""
    waypoints = place_via(robot, via_in_order, nodes_of_via, q_start, goal_at_pose, horizon.steps)
    conditions: tuple[Condition, ...] = (*waypoints, *contact_conditions(switches))
    timeline = timeline_of(phase, conditions, switches, horizon, bounds_of_sum, lengths)
    places = timeline.places
    return timeline, (*(constraint.at_via(places) for constraint in path_with_contacts), *conditions)


def _obstacles(
    robot: Robot,
    said_obstacle: Sequence[Obstacle],
    said_self_collision: SelfCollision | bool | None,
    limits: Bounds,
    limits_at_end: Bounds,
    q_start: Array,
    goal_at_pose: Goal,
    path_with_junctions: tuple[BoundedTerm, ...],
) -> tuple[tuple[Obstacle, ...], SelfCollision | None, Clearance | None, tuple[BoundedTerm, ...], Goal]:
    """Pairs of spheres and what they keep away from, as the last path constraint."""
    said = said_self_collision
    own = said if isinstance(said, SelfCollision) else SelfCollision() if said else None
    obstacle = tuple(said_obstacle)
    if not obstacle and own is None:
        return obstacle, own, None, path_with_junctions, goal_at_pose
    is_given = goal_at_pose.is_exact and goal_at_pose.q_active.all()
    found = clearance_of(robot, obstacle, own, limits, [q_start, goal_at_pose.q] if is_given else [q_start])
    path = (*path_with_junctions, found) if found.rows else path_with_junctions
    return obstacle, own, found, path, clear_configuration(robot, goal_at_pose, q_start, limits_at_end, found)


def _cost(robot: Robot, said_cost: Cost, limits: Bounds, num_steps: int) -> Cost:
    """Refuse weights that do not fit the robot."""
    cost = said_cost.on_controls(robot.nu)
    cost.check_controls(limits.finite("u"), [label.name for label in robot.u_labels])
    cost.check_dimensions(robot.nq, robot.nv, num_steps)
    return cost


RESOLVE = (
    Step.of(_duration, "duration", "duration_range"),
    Step.of(_steps, "horizon", "num_steps", "lengths", "accuracy", "said_steps_of_impacts"),
    Step.of(choose_scheme, "scheme", "chooses_scheme", "scheme_reason"),
    Step.of(check_integrator),
    Step.of(check_has_actuators),
    Step.of(lambda said_limits, robot: said_limits.complete(robot), "limits"),
    Step.of(schedule_of, "schedule"),
    Step.of(_phase, "phase", "bounds_of_sum"),
    Step.of(_limits_of_ends, "widest", "limits_at_start", "limits_at_end"),
    Step.of(check_coordinates),
    Step.of(check_free_contacts),
    Step.of(check_terms, "terms", "path_of_frames"),
    Step.of(_start, "q_start", "v_start", "a_start"),
    Step.of(_find_active_rows, "switches", "path_with_contacts"),
    Step.of(order_via, "via_in_order", "nodes_of_via"),
    Step.of(settle_goal, "goal_at_pose"),
    Step.of(_timeline, "timeline", "path_with_junctions"),
    Step.of(_obstacles, "obstacle", "self_collision", "clearance", "path", "goal"),
    Step.of(check_parameters),
    Step.of(check_robust),
    Step.of(check_periodic),
    Step.of(check_cycle),
    Step.of(check_free_start),
    Step.of(check_steps),
    Step.of(_cost, "cost"),
    Step.of(check_weights),
    Step.of(check_rates),
    Step.of(check_mean_squares),
    Step.of(check_inequalities),
    Step.of(check_solver),
    Step.of(check_guess),
)
