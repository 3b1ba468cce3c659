"""From the tables of a problem file, or the arguments of `Problem.create`, to arrays for a robot.

Each step reads one table. Its values have names that begin with `said_` where `mbocp.problem.resolve` makes
more of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from mbocp._arrays import Array
from mbocp._memory import check_horizon
from mbocp.problem.file.cost_table import CostReader, read_cost
from mbocp.problem.file.gait_table import GaitTable, phases_of_gait
from mbocp.problem.file.goal_table import GoalTable, read_excite, read_goals
from mbocp.problem.file.ground_table import on_ground
from mbocp.problem.file.guess_table import read_guess
from mbocp.problem.file.integrator_table import read_integrator
from mbocp.problem.file.limits_table import LimitsTable, read_limits
from mbocp.problem.file.messages import schema_error
from mbocp.problem.file.obstacle_table import obstacles_from, self_collision_from
from mbocp.problem.file.parameter_table import parameters_from
from mbocp.problem.file.path_table import PathTable, path_from
from mbocp.problem.file.phase_table import (
    HorizonTable,
    PhaseTable,
    horizon_from,
    phases_from,
    weigh_phases,
    with_paths,
    with_via,
)
from mbocp.problem.file.profile import Profile, profile_of
from mbocp.problem.file.robust_table import read_robust
from mbocp.problem.file.schema import ProblemTable, check_tables
from mbocp.problem.file.start_table import read_start
from mbocp.problem.file.term_table import terms_from
from mbocp.problem.file.via_table import ViaTable, via_from
from mbocp.problem.found_parameter import open_robot
from mbocp.problem.goals.goal import Goal
from mbocp.problem.pipeline import Step
from mbocp.problem.solver import SolverOptions
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.via import ViaPoint
from mbocp.robot import Robot


def read_tables(document: Mapping[str, Any], label: str) -> dict[str, Any]:
    """Check the tables of a problem against the schema; they are by their names.

    Raises
    ------
    ProblemFileError
    """
    try:
        return check_tables(document)
    except ValidationError as error:
        raise schema_error(label, ProblemTable, error) from error


def _is_cycle(goal_table: GoalTable, gait_table: GaitTable | None) -> bool:
    """Whether the last phase goes on in the first."""
    return bool(goal_table.periodic) or (gait_table is not None and gait_table.repeats)


def _horizon(
    horizon_table: HorizonTable, phases_unweighted: tuple[Phase, ...], robot: Robot
) -> tuple[Any, ...]:
    whole = horizon_from(horizon_table, phases_unweighted)
    check_horizon(whole.steps, 2 * (robot.nv + robot.num_speeds) + robot.nu)  # at least: some have more
    written = horizon_table
    ends = whole.duration, whole.duration_range, whole.steps
    return *ends, written.lengths, written.accuracy, written.controls


def _via(
    via_table: list[ViaTable], phases_on_ground: list[PhaseTable], robot: Robot, said_q_start: Array
) -> tuple[ViaPoint, ...]:
    return via_from(robot, with_via(via_table, phases_on_ground), said_q_start)


def _path(
    path_table: list[Any],
    phases_on_ground: list[PhaseTable],
    forces_of_feet: list[Any],
    limits_table: LimitsTable,
    profile: Profile | None,
    robot: Robot,
    said_q_start: Array,
    said_goal: Goal,
    folder: Path,
) -> tuple[Any, ...]:
    of_profile = [PathTable(**table) for table in profile.paths(robot)] if profile is not None else []
    speeds = [
        PathTable.model_validate({"kind": "motor_speed", "frame": motor.name, "max": motor.speed})
        for motor in (robot.found_gears if limits_table.velocity is True else ())
        if np.isfinite(motor.speed)
    ]
    tables = [*with_paths(path_table, phases_on_ground), *forces_of_feet, *of_profile, *speeds]
    return path_from(robot, tables, said_q_start, said_goal, folder)


READ = (
    Step.of(parameters_from, "parameter"),
    Step.of(open_robot, "robot"),
    Step.of(read_start, "said_q_start", "said_v_start", "said_a_start", "u_start", "start_free"),
    Step.of(_is_cycle, "is_cycle"),
    Step.of(phases_of_gait, "phases_of_gait"),
    Step.of(on_ground, "phases_on_ground", "forces_of_feet"),
    Step.of(phases_from, "phases_unweighted"),
    Step.of(
        _horizon,
        "said_duration",
        "said_duration_range",
        "said_num_steps",
        "said_lengths",
        "said_accuracy",
        "controls",
    ),
    Step.of(read_goals, "said_goal", "goals"),
    Step.of(read_excite, "excite"),
    Step.of(lambda limits_table, robot, folder: profile_of(limits_table.profile, robot, folder), "profile"),
    Step.of(read_limits, "said_limits"),
    Step.of(read_robust, "robust"),
    Step.of(_via, "said_via"),
    Step.of(CostReader, "cost_reader"),
    Step.of(read_cost, "said_cost"),
    Step.of(weigh_phases, "said_phase"),
    Step.of(_path, "said_path"),
    Step.of(obstacles_from, "said_obstacle"),
    Step.of(self_collision_from, "said_self_collision"),
    Step.of(terms_from, "said_terms"),
    Step.of(read_integrator, "said_scheme", "lie", "substeps", "stabilisation"),
    Step.of(read_guess, "guess"),
    Step.of(lambda solver_table: SolverOptions(**dict(solver_table)), "solver"),
)
