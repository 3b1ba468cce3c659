"""From the tables of a problem file, or the arguments of `Problem.create`, to arrays for a robot.

Each step reads one table. Its values have names that begin with `said_` where `mbocp.problem.resolve` makes
more of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from mbocp._arrays import Array, BoolArray
from mbocp._files import is_file
from mbocp._text import shown
from mbocp.exceptions import ProblemError
from mbocp.mechanisms.completion import assembled, assembled_velocity
from mbocp.problem._checks import MAX_POSITION, check_size
from mbocp.problem.cost import Cost, further_terms
from mbocp.problem.file.frame_table import frames_from
from mbocp.problem.file.limits_table import bounds_from
from mbocp.problem.file.messages import located, schema_error
from mbocp.problem.file.named_values import configuration_from, control_from, tangent_from, weights_from
from mbocp.problem.file.obstacle_table import obstacles_from, self_collision_from
from mbocp.problem.file.path_table import path_from
from mbocp.problem.file.periodic_table import free_from, periodic_from
from mbocp.problem.file.phase_table import (
    horizon_from,
    phase_weights,
    phases_from,
    with_paths,
    with_via,
)
from mbocp.problem.file.schema import (
    GoalMemberTable,
    GoalTable,
    GuessTable,
    HorizonTable,
    IntegratorTable,
    LimitsTable,
    ObstacleTable,
    PhaseTable,
    ProblemTable,
    SelfCollisionTable,
    SolverTable,
    StartTable,
    ViaTable,
    checked_tables,
)
from mbocp.problem.file.target import read_target
from mbocp.problem.file.term_table import terms_from
from mbocp.problem.file.via_table import via_from
from mbocp.problem.goals.drives import without_driven_velocities
from mbocp.problem.goals.frames import start_at
from mbocp.problem.goals.free_start import FreeStart
from mbocp.problem.goals.goal import RATES, Goal
from mbocp.problem.goals.goal_set import of_member
from mbocp.problem.guess import Guess
from mbocp.problem.integration import Stabilisation
from mbocp.problem.limits import Bounds
from mbocp.problem.memory import check_horizon
from mbocp.problem.obstacles.clearance import SelfCollision
from mbocp.problem.pipeline import Step
from mbocp.problem.solver import SolverOptions
from mbocp.problem.timeline.phase import Phase, checked_phase
from mbocp.problem.timeline.sequence import are_alike
from mbocp.problem.timeline.times import check_duration
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.typical import typical_force, velocity_weight
from mbocp.robot import Robot
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.robot.loading.load import load_keys
from mbocp.robot.loading.robot_keys import RobotKeys
from mbocp.terms import COST_TERMS, OwnTerm
from mbocp.terms.tables import WeightsTable
from mbocp.terms.written import AUTO


def read_tables(document: Mapping[str, Any], label: str) -> dict[str, Any]:
    """Check the tables of a problem against the schema; they are by their names.

    Raises
    ------
    ProblemFileError
    """
    try:
        return checked_tables(document)
    except ValidationError as error:
        raise schema_error(label, ProblemTable, error) from error


def load_its_robot(keys: RobotKeys, folder: Path | None) -> Robot:
    """Load the robot that a problem names."""
    with located("robot"):
        return load_keys(keys, folder)


def _phases(phase_table: list[PhaseTable], robot: Robot) -> tuple[Phase, ...]:
    """The phases, but for their weights."""
    return phases_from(robot, phase_table)


def _horizon(
    horizon_table: HorizonTable, phases_unweighted: tuple[Phase, ...], robot: Robot
) -> tuple[Any, ...]:
    whole = horizon_from(horizon_table, phases_unweighted)
    check_horizon(whole.steps, 2 * (robot.nv + robot.num_speeds) + robot.nu)  # at least: some have more
    written = horizon_table
    ends = whole.duration, whole.duration_range, whole.steps
    return *ends, written.lengths, written.accuracy, written.controls


def _start(start_table: StartTable, robot: Robot) -> tuple[Array, Array, Array, FreeStart | None]:
    q, v = _start_state(start_table, robot)
    has_a = start_table.a is not None
    a = _tangent(robot, start_table.a, "start.a")[0] if has_a else np.zeros(0)
    return q, v, a, free_from(robot, start_table.free)


def _goal_or_goals(goal_table: GoalTable, robot: Robot, said_q_start: Array) -> tuple[Goal, tuple[Goal, ...]]:
    """The goal, and all of them where there are several."""
    goals = _goals(goal_table, robot, said_q_start)
    return (goals[0] if goals else _goal(goal_table, robot, said_q_start)), goals


def _limits(limits_table: LimitsTable, robot: Robot) -> Bounds:
    return bounds_from(robot, **dict(limits_table))


def _via(
    via_table: list[ViaTable], phase_table: list[PhaseTable], robot: Robot, said_q_start: Array
) -> tuple[ViaPoint, ...]:
    return via_from(robot, with_via(via_table, phase_table), said_q_start)


def _cost_reader(
    robot: Robot,
    said_goal: Goal,
    folder: Path,
    said_duration: float,
    said_duration_range: tuple[float, float] | None,
    said_via: tuple[ViaPoint, ...],
    phases_unweighted: tuple[Phase, ...],
    said_num_steps: int,
    said_q_start: Array,
    said_v_start: Array,
) -> _CostReader:
    has_free_times = any(point.is_free for point in said_via) or not are_alike(phases_unweighted)
    horizon = {"duration": said_duration, "duration_range": said_duration_range}
    start = (said_q_start, said_v_start)
    return _CostReader(robot, said_goal, folder, horizon, has_free_times, said_num_steps, *start)


def _cost(cost_table: Any, goals: tuple[Goal, ...], is_cost_left: bool, cost_reader: _CostReader) -> Cost:
    """The cost; that of a file without one weighs velocities as suits the motion."""
    table = cost_table.model_copy(update={"velocity": AUTO}) if is_cost_left else cost_table
    if goals and table.tracking and table.target is None and table.target_file is None:
        raise ProblemError("cost.tracking: of several goals none is the target; give cost.target")
    values: dict[str, Any] = {}
    for term in COST_TERMS:
        values |= term.read(table, cost_reader)
    further = {key: values.pop(key) for key in further_terms()}
    return Cost(**values, further=further)


def _weights_of_phases(
    phase_table: list[PhaseTable], phases_unweighted: tuple[Phase, ...], cost_reader: _CostReader
) -> tuple[Phase, ...]:
    return tuple(
        checked_phase(replace(phase, weights=phase_weights(table, cost_reader)))
        for phase, table in zip(phases_unweighted, phase_table, strict=True)
    )


def _path(
    path_table: list[Any],
    phase_table: list[PhaseTable],
    robot: Robot,
    said_q_start: Array,
    said_goal: Goal,
    folder: Path,
) -> tuple[Any, ...]:
    return path_from(robot, with_paths(path_table, phase_table), said_q_start, said_goal, folder)


def _obstacles(obstacle_table: list[ObstacleTable], folder: Path) -> tuple[Obstacle, ...]:
    return obstacles_from(obstacle_table, folder)


def _self_collision(
    self_collision_table: bool | SelfCollisionTable | None, folder: Path
) -> SelfCollision | bool | None:
    return self_collision_from(self_collision_table, folder)


def _terms(terms_table: list[Any], robot: Robot, terms_given: tuple[OwnTerm, ...]) -> tuple[OwnTerm, ...]:
    return terms_from(robot, terms_table, terms_given)


def _integrator(integrator_table: IntegratorTable) -> tuple[str, str, int, Stabilisation]:
    table = integrator_table
    rates = Stabilisation(
        gamma_quaternion=table.gamma_quaternion,
        gamma_dcm=table.gamma_dcm,
        gamma_constraint=table.gamma_constraint,
    )
    return table.scheme, table.lie, table.substeps, rates


def _solver(solver_table: SolverTable) -> SolverOptions:
    return SolverOptions(**solver_table.model_dump())


def _start_state(table: StartTable, robot: Robot) -> tuple[Array, Array]:
    q = _start_configuration(table, robot)
    if table.v is not None and table.p is not None:
        raise ProblemError("start: give v or p, not both")
    if table.p is not None:
        p, _ = _tangent(robot, table.p, "start.p")
        v = np.array(robot.velocity_from_momentum(q, p))
        return q, np.array(robot.assemble_velocity(q, v)) if table.assemble else v
    if table.v is None:
        return q, np.zeros(robot.nv)
    v, active = _tangent(robot, table.v, "start.v")
    return q, assembled_velocity(robot, q, v, active, assemble=table.assemble)


def _start_configuration(table: StartTable, robot: Robot) -> Array:
    q, written = np.array(robot.q0), np.zeros(robot.nv, dtype=np.bool_)
    if table.q is not None:
        with located("start.q"):
            q, written = configuration_from(robot, table.q, robot.q0, "start.q")
            q = np.array(robot.normalise(q, name="start.q"))
            check_size("start.q", q, robot.q_labels, MAX_POSITION)
            if not table.frame:
                q = assembled(robot, q, written, assemble=table.assemble, base=robot.q0, key="start.q")
    if not table.frame:
        return q
    targets = [goal.target for goal in frames_from(table.frame, key="start.frame")]
    return start_at(robot, targets, q, written)


def _goals(table: GoalTable, robot: Robot, q_start: Array) -> tuple[Goal, ...]:
    """Several goals, each with what is common to all where it says nothing itself."""
    common = {key: getattr(table, key) for key in table.model_fields_set - {"any"}}
    goals = []
    for place, member in enumerate(table.any):
        given = member.model_fields_set
        own = given | (set(RATES) if given & set(RATES) else set())
        inherited = {key: value for key, value in common.items() if key not in own}
        with of_member(place):
            goals.append(_goal(member.model_copy(update=inherited), robot, q_start))
    return tuple(goals)


def _goal(table: GoalMemberTable, robot: Robot, q_start: Array) -> Goal:
    q, q_active = np.array(q_start), np.zeros(robot.nv, dtype=np.bool_)
    value, rate_active = np.zeros(robot.nv), np.zeros(robot.nv, dtype=np.bool_)
    if table.q is not None:
        with located("goal.q"):
            q, q_active = configuration_from(robot, table.q, q_start, "goal.q")
            q = np.array(robot.normalise(q, name="goal.q"))
            check_size("goal.q", q, robot.q_labels, MAX_POSITION)
            if table.assemble:
                q = assembled(robot, q, q_active, assemble=True, base=q_start, key="goal.q")
    if table.v is not None and table.p is not None:
        raise ProblemError("goal: give v or p, not both")
    rate = "v" if table.v is not None else "p"
    written = table.v if table.v is not None else table.p
    if written is not None:
        value, rate_active = _tangent(robot, written, f"goal.{rate}")
    if table.assemble and rate == "v" and rate_active.all():
        value = assembled_velocity(robot, q, value, rate_active, assemble=True)
    a, a_active = (
        _tangent(robot, table.a, "goal.a")
        if table.a is not None and table.a != "free"
        else (np.zeros(robot.nv), np.zeros(robot.nv, dtype=np.bool_))
    )
    says = [table.q is not None, written is not None, a_active.any(), bool(table.frame), table.periodic]
    enforce = table.enforce if table.enforce is not None else ("exact" if any(says) else "none")
    goal = Goal(
        q=q,
        a=a,
        a_active=a_active,
        a_rule="free" if table.a == "free" else "given",
        q_active=q_active,
        rate=rate,  # type: ignore[arg-type]
        value=value,
        rate_active=rate_active,
        frames=frames_from(table.frame),
        periodic=periodic_from(table.periodic),
        enforce=enforce,  # type: ignore[arg-type]  # checked by the class
        guard=table.guard,
        redundant=table.redundant,  # type: ignore[arg-type]
    )
    return without_driven_velocities(robot, goal)


def _tangent(robot: Robot, written: Any, key: str) -> tuple[Array, BoolArray]:
    if isinstance(written, float):  # 0 for all
        return np.zeros(robot.nv), np.ones(robot.nv, dtype=np.bool_)
    with located(key):
        return tangent_from(robot, written, key)


@dataclass(frozen=True)
class _CostReader:
    """From the values of `[cost]` to arrays, see `mbocp.terms.Reader`."""

    robot: Robot
    goal: Goal
    folder: Path
    horizon: dict[str, Any]  # duration and its range
    has_free_times: bool  # of via points
    num_steps: int
    q_start: Array
    v_start: Array

    def on_controls(self, written: Any, key: str) -> Any:
        if isinstance(written, float):
            return written  # one for all; errors name no control then
        with located(key):
            return control_from(self.robot, written, key)

    def on_velocities(self, written: Any, key: str) -> Array:
        if written is None:
            return np.zeros(self.robot.nv)
        if written == AUTO:
            goal = self.goal
            T, _ = check_duration(self.horizon["duration"], self.horizon["duration_range"])
            ends = (self.q_start, self.v_start, goal.q, goal.q_active)
            return velocity_weight(self.robot, typical_force(self.robot, *ends, T), T)
        with located(key):
            return weights_from(self.robot, written, key)

    def targets(self, target: Any, target_file: str | None) -> tuple[Array, Array, BoolArray]:
        robot, goal = self.robot, self.goal
        target_q, given_q = goal.q, goal.q_active
        target_p, given_p = _goal_momentum(robot, goal)
        if target is not None and target_file is not None:
            raise ProblemError("cost: give target or target_file, not both")
        if target is not None:
            target_q, given_q = _target_rows(robot, target.q, "q", goal.q)
            target_p, given_p = _target_rows(robot, target.p, "p", np.zeros(robot.nv))
        elif target_file is not None:
            path = self.folder / target_file
            if self.horizon["duration_range"] is not None or self.has_free_times:
                what = "horizon.duration is" if self.horizon["duration_range"] is not None else "via.time is"
                raise ProblemError(
                    f"cost.target_file: a file says when the robot is where, and {what} free; "
                    "give a number there, or cost.target, whose rows belong to the steps"
                )
            target_q, target_p = read_target(path, robot, self.horizon["duration"], self.num_steps)
            given_q = given_p = np.ones(robot.nv, dtype=np.bool_)
        return target_q, target_p, np.concatenate([given_q, given_p])

    def goal_says(self) -> BoolArray:
        return np.concatenate([self.goal.q_active, self.goal.rate_active])

    def on_states(self, written: WeightsTable | None, default: BoolArray, key: str) -> Array:
        return _weights(self.robot, written, default, key)

    def check_weighed(self, weights: Array, given: BoolArray, key: str, source: str) -> None:
        if source == "the goal" and self.goal.frames and not weights.any():
            return  # frames have weights of their own
        _check_targets(self.robot, weights, given, key, source)


def _goal_momentum(robot: Robot, goal: Goal) -> tuple[Array, BoolArray]:
    """Return the momentum at the goal, and which components of it the goal determines."""
    if goal.rate == "p":
        return goal.value, goal.rate_active
    is_known = bool(goal.rate_active.all())
    if not (is_known and goal.value.any()):
        return np.zeros(robot.nv), np.full(robot.nv, is_known)  # at rest p = 0, whatever q
    if goal.q_active.all():
        return np.array(robot.momentum(goal.q, goal.value)), goal.rate_active
    return np.zeros(robot.nv), np.zeros(robot.nv, dtype=np.bool_)


def _target_rows(robot: Robot, written: Any, letter: str, base: Array) -> tuple[Array, BoolArray]:
    """Return a target, one row or one for each step, and which directions of it were written."""
    key = f"cost.target.{letter}"
    if written is None:
        return base, np.zeros(robot.nv, dtype=np.bool_)
    is_trajectory = isinstance(written, list) and written and isinstance(written[0], list)
    rows, active = [], np.ones(robot.nv, dtype=np.bool_)
    with located(key):
        for row in written if is_trajectory else [written]:
            if letter == "q":
                q, active = configuration_from(robot, row, base, key)
                rows.append(robot.normalise(q, name=key))
            else:
                p, active = tangent_from(robot, row, key)
                rows.append(p)
    return (np.array(rows) if is_trajectory else np.array(rows[0])), active


def _weights(robot: Robot, table: WeightsTable | None, default: BoolArray, key: str) -> Array:
    if table is None:
        return np.asarray(default, dtype=np.float64)
    with located(key):
        if table.qp is not None:
            return np.array(table.qp)
        parts = [
            weights_from(robot, part, f"{key}.{letter}") if part is not None else np.zeros(robot.nv)
            for letter, part in (("q", table.q), ("p", table.p))
        ]
        return np.concatenate(parts)


def _check_targets(robot: Robot, weights: Array, given: BoolArray, key: str, source: str) -> None:
    """Refuse a weight on a component that has no target."""
    if weights.shape != given.shape:
        return  # the class says what is wrong with the length
    missing = np.flatnonzero((weights != 0.0) & ~given)
    if missing.size:
        index = int(missing[0])
        labels = [*robot.v_labels, *robot.p_labels]
        part = "q" if index < robot.nv else "p"
        raise ProblemError(
            f"{key}[{index}]: got {weights[index]:g} on {part} of {labels[index].name!r}, but {source} does "
            f"not say {part} there; add it, or set the weight to 0"
        )
    if not weights.any():
        raise ProblemError(f"{key}: all weights are 0, expected at least one above 0")


def _guess(guess_table: GuessTable, robot: Robot, said_q_start: Array, folder: Path) -> Guess:
    """Make the guess; a `kind` that is written leaves the other kinds' keys unused (`--set guess.kind=`)."""
    table, q_start = guess_table, said_q_start
    kind = table.kind
    if kind is None:
        given = {"control": table.u, "way": table.q, "solution": table.file}
        kind = next((name for name, value in given.items() if value is not None), "auto")
    u = control_from(robot, table.u, "guess.u") if table.u is not None and kind == "control" else None
    path = folder / table.file if table.file is not None and kind == "solution" else None
    if path is not None and not is_file(path):
        raise ProblemError(f"guess.file: no such file {shown(str(path))}")
    q = _corners(table.q, robot, q_start) if table.q is not None and kind == "way" else None
    at = table.at if kind == "solution" else None
    return Guess(kind=kind, u=u, path=path, q=q, at=at)  # type: ignore[arg-type]  # checked by the class


def _corners(written: Sequence[Any], robot: Robot, q_start: Array) -> Array:
    """Configurations of a guess, shape (n, nq); joints that one does not name are where they start."""
    if not written:
        raise ProblemError("guess.q: expected at least one configuration between start and goal")
    found = [configuration_from(robot, row, q_start, "guess.q")[0] for row in written]
    return np.array([robot.normalise(q, name="guess.q") for q in found])


READ = (
    Step.of(_phases, "phases_unweighted"),
    Step.of(
        _horizon,
        "said_duration",
        "said_duration_range",
        "said_num_steps",
        "said_lengths",
        "said_accuracy",
        "controls",
    ),
    Step.of(_start, "said_q_start", "said_v_start", "said_a_start", "start_free"),
    Step.of(_goal_or_goals, "said_goal", "goals"),
    Step.of(_limits, "said_limits"),
    Step.of(_via, "said_via"),
    Step.of(_cost_reader, "cost_reader"),
    Step.of(_cost, "said_cost"),
    Step.of(_weights_of_phases, "said_phase"),
    Step.of(_path, "said_path"),
    Step.of(_obstacles, "said_obstacle"),
    Step.of(_self_collision, "said_self_collision"),
    Step.of(_terms, "said_terms"),
    Step.of(_integrator, "said_scheme", "lie", "substeps", "stabilisation"),
    Step.of(_guess, "guess"),
    Step.of(_solver, "solver"),
)
