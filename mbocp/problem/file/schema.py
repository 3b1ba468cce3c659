"""The problem file as pydantic models: which keys there are and what kind of value each takes.

Only the shape of the file is checked here. What depends on the robot (lengths, joint names) is checked when
the values are resolved, what depends on the mathematics when the `Problem` is made: once, for files and for
Python. Modules beside this one declare the keys of most tables, where they read and write them.

Defaults that are tables are made by `model_construct`, which asks for no validator: pydantic takes several
milliseconds to build one, and that of the whole file has all in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any, Literal

from pydantic import Field, create_model

from mbocp._json_schema import json_schema_of, unite
from mbocp._keys import Key, Kind, Table
from mbocp._text import show
from mbocp.problem._checks import choice
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.file.cost_table import CostTable
from mbocp.problem.file.gait_table import GaitTable
from mbocp.problem.file.goal_table import GoalTable
from mbocp.problem.file.ground_table import GroundTable
from mbocp.problem.file.guess_table import GuessTable
from mbocp.problem.file.integrator_table import IntegratorTable
from mbocp.problem.file.limits_table import LimitsTable
from mbocp.problem.file.obstacle_table import ObstacleTable, SelfCollisionTable
from mbocp.problem.file.overrides import SHORT
from mbocp.problem.file.parameter_table import ParameterTable
from mbocp.problem.file.path_table import PathTable
from mbocp.problem.file.phase_table import HorizonTable, PhaseTable
from mbocp.problem.file.robust_table import RobustTable
from mbocp.problem.file.start_table import StartTable
from mbocp.problem.file.term_table import TermTable
from mbocp.problem.file.via_table import ViaTable
from mbocp.problem.solver import SolverTable
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
