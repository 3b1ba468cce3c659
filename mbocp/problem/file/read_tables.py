"""The problem file as pydantic models, and from its tables, or arguments of `Problem.create`, to arrays.

Each step reads one table. Its values have names that begin with `said_` where `mbocp.problem.resolve` makes
more of them.

Only the shape of the file is checked here. What depends on the robot (lengths, joint names) is checked when
the values are resolved, what depends on the mathematics when the `Problem` is made: once, for files and for
Python. Modules beside this one declare the keys of most tables, where they read and write them.

Defaults that are tables are made by `model_construct`, which asks for no validator: pydantic takes several
milliseconds to build one, and that of the whole file has all in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError, create_model

from mbocp._arrays import Array
from mbocp._json_schema import json_schema_of, unite
from mbocp._keys import Key, Kind, Table
from mbocp._memory import check_horizon
from mbocp._text import show
from mbocp.problem._checks import choice
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.file.cost_table import CostReader, CostTable, read_cost
from mbocp.problem.file.gait_table import GaitTable, phases_of_gait
from mbocp.problem.file.goal_table import GoalTable, read_excite, read_goals
from mbocp.problem.file.ground_table import GroundTable, on_ground
from mbocp.problem.file.limits_table import LimitsTable, read_limits
from mbocp.problem.file.messages import schema_error
from mbocp.problem.file.obstacle_table import (
    ObstacleTable,
    SelfCollisionTable,
    obstacles_from,
    self_collision_from,
)
from mbocp.problem.file.overrides import SHORT
from mbocp.problem.file.path_table import PathTable, path_from
from mbocp.problem.file.phase_table import (
    HorizonTable,
    PhaseTable,
    horizon_from,
    paths_of_phases,
    phases_from,
    weigh_phases,
    with_via,
)
from mbocp.problem.file.profile import Profile, profile_of
from mbocp.problem.file.robust_table import ParameterTable, RobustTable, parameters_from, read_robust
from mbocp.problem.file.scheme_tables import GuessTable, IntegratorTable, read_guess, read_integrator
from mbocp.problem.file.start_tables import StartTable, ViaTable, read_start, via_from
from mbocp.problem.file.term_table import TermTable, terms_from
from mbocp.problem.found_parameter import open_robot
from mbocp.problem.goals.goal import Goal
from mbocp.problem.pipeline import Step
from mbocp.problem.solver import SolverOptions, SolverTable
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.via import ViaPoint
from mbocp.robot import Robot
from mbocp.robot.loading.robot_keys import RobotKeys


def _expand_robot(value: Any) -> Any:
    if isinstance(value, str):
        return {SHORT["robot"]: value}
    if not isinstance(value, Mapping):
        raise ValueError(f"got {show(value)}, expected a name, a path or a table with the key name")
    return value


def _expand_limits(value: Any) -> Any:
    if value == "profile":
        return {"profile": True}
    if isinstance(value, str):
        raise ValueError(f'got {show(value)}, expected "profile" or a table')
    return value


def _whether_or_how(value: Any) -> Any:
    if isinstance(value, bool):
        return {} if value else None
    if value is None or isinstance(value, Mapping):
        return value
    raise ValueError(f"got {show(value)}, expected true, false or a table")


def _expand_solver(value: Any) -> Any:
    return {SHORT["solver"]: value} if isinstance(value, str) else value


class ProblemTable(Table):
    """A whole problem file."""

    robot: Annotated[RobotKeys, Kind("string or table", _expand_robot, str), Key("name or path; or a table")]
    coordinates: Annotated[
        str,
        choice(COORDINATES),
        Key(
            "displacements of joints, or positions and directors of bodies: "
            "[Natural coordinates](natural_coordinates.md)"
        ),
    ] = "joint"
    horizon: Annotated[HorizonTable, Key("how long, and in how many steps")] = HorizonTable.model_construct()
    phase: Annotated[list[PhaseTable], Key("[phases](phases.md) of the motion")] = Field(default_factory=list)
    ground: Annotated[GroundTable | None, Key("what [feet](contact.md#legs) stand on", "", "none")] = None
    gait: Annotated[
        GaitTable | None, Key("a [gait](contact.md#gaits), in the place of phases", "", "none")
    ] = None
    start: Annotated[StartTable, Key("state at t = 0")] = StartTable.model_construct()
    goal: Annotated[GoalTable, Key("state at t = T")] = GoalTable.model_construct()
    cost: Annotated[CostTable, Key("what is minimised")] = CostTable.model_construct()  # type: ignore[valid-type]
    limits: Annotated[
        LimitsTable,
        Kind('`"profile"`, or table', _expand_limits, Literal["profile"]),
        Key("bounds along the motion"),
    ] = LimitsTable.model_construct()
    robust: Annotated[RobustTable | None, Key("what is [uncertain](robust.md)", "", "none")] = None
    via: Annotated[list[ViaTable], Key("[via points](#via-points)")] = Field(default_factory=list)
    path: Annotated[
        list[PathTable],  # type: ignore[valid-type]
        Key("[path constraints](#path-constraints)"),
    ] = Field(default_factory=list)
    obstacle: Annotated[list[ObstacleTable], Key("[obstacles](obstacles.md)")] = Field(default_factory=list)
    self_collision: Annotated[
        SelfCollisionTable | None,
        Kind("boolean, or table", _whether_or_how, bool),
        Key("whether links [keep apart](obstacles.md#self-collision)", "", "false"),
    ] = None
    terms: Annotated[list[TermTable], Key("[terms of one's own](terms.md)")] = Field(default_factory=list)  # type: ignore[valid-type]
    guess: Annotated[GuessTable, Key("where the solver starts")] = GuessTable.model_construct()
    parameter: Annotated[
        list[ParameterTable], Key("[numbers of the robot](parameters.md) that are found")
    ] = Field(default_factory=list)
    integrator: Annotated[IntegratorTable, Key("how time is discretised")] = IntegratorTable.model_construct()
    solver: Annotated[
        SolverTable,
        Kind("string or table", _expand_solver, str),
        Key("a method's name, or a table", "", '`"auto"`'),
    ] = SolverTable.model_construct()


def problem_schema() -> dict[str, Any]:
    """Return the JSON schema of problem files: editors complete keys by it, and check them."""
    about = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "problem file of mbocp"}
    return {**unite(json_schema_of(ProblemTable)), **about}


def check_tables(document: Mapping[str, Any]) -> dict[str, Any]:
    """Tables of a whole problem file by their names, checked by a model of those that it has.

    What is not there is what it is by default. A validator for all of it takes pydantic three times as long
    to build as one for the tables of most files.

    Raises
    ------
    pydantic.ValidationError
        If there are unknown keys, or values of a wrong kind.
    """
    keys = frozenset(name for name in ProblemTable.model_fields if name in document or name == "robot")
    return {**_defaults(), **dict(_model_of(keys).model_validate(document))}


@lru_cache(maxsize=1)
def _defaults() -> dict[str, Any]:
    """Of the tables that a file leaves out."""
    fields = ProblemTable.model_fields.items()
    return {name: field.get_default(call_default_factory=True) for name, field in fields if name != "robot"}


@lru_cache(maxsize=32)
def _model_of(keys: frozenset[str]) -> type[Table]:
    fields: dict[str, Any] = {
        name: (field.annotation, field) for name, field in ProblemTable.model_fields.items() if name in keys
    }
    return create_model(ProblemTable.__name__, __base__=Table, **fields)


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


def _own_path(
    path_table: list[Any], robot: Robot, said_q_start: Array, said_goal: Goal, folder: Path
) -> tuple[Any, ...]:
    tables = [(f"path.{i}", table) for i, table in enumerate(path_table)]
    return path_from(robot, tables, said_q_start, said_goal, folder)


def _path_of_others(
    phases_on_ground: list[PhaseTable],
    forces_of_feet: list[Any],
    limits_table: LimitsTable,
    profile: Profile | None,
    robot: Robot,
    said_q_start: Array,
    said_goal: Goal,
    folder: Path,
) -> tuple[Any, ...]:
    """Path constraints of other tables: of phases, of the ground, and of limits of motors."""
    of_profile = [PathTable(**table) for table in profile.paths(robot)] if profile is not None else []
    speeds = [
        PathTable.model_validate({"kind": "motor_speed", "frame": motor.name, "max": motor.speed})
        for motor in (robot.found_gears if limits_table.velocity is True else ())
        if np.isfinite(motor.speed)
    ]
    tables = [
        *paths_of_phases(phases_on_ground),
        *(("ground", table) for table in forces_of_feet),
        *(("limits.profile", table) for table in of_profile),
        *(("limits.velocity", table) for table in speeds),
    ]
    return path_from(robot, tables, said_q_start, said_goal, folder)


def _path(own_path: tuple[Any, ...], path_of_others: tuple[Any, ...]) -> tuple[Any, ...]:
    return (*own_path, *path_of_others)


READ = (
    Step.of(parameters_from, "parameter"),
    Step.of(open_robot, "robot"),
    Step.of(read_start, "said_q_start", "said_v_start", "said_a_start", "u_start", "start_free"),
    Step.of(_is_cycle, "is_cycle"),
    Step.of(phases_of_gait, "phases_of_gait"),
    Step.of(on_ground, "phases_on_ground", "forces_of_feet", "free_feet"),
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
    Step.of(_own_path, "own_path"),
    Step.of(_path_of_others, "path_of_others"),
    Step.of(_path, "said_path"),
    Step.of(obstacles_from, "said_obstacle"),
    Step.of(self_collision_from, "said_self_collision"),
    Step.of(terms_from, "said_terms"),
    Step.of(read_integrator, "said_scheme", "lie", "substeps", "stabilisation"),
    Step.of(read_guess, "guess"),
    Step.of(lambda solver_table: SolverOptions(**dict(solver_table)), "solver"),
)
