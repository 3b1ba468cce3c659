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
from typing import Annotated, Any

from pydantic import Field, create_model

from mbocp._keys import Key, Kind, Table, json_schema_of
from mbocp._text import show
from mbocp.integrators import CONTROLS
from mbocp.problem._checks import choice, whole
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.file.cost_table import CostTable, PhaseCostTable
from mbocp.problem.file.frame_table import FrameGoalTable
from mbocp.problem.file.goal_table import GoalTable
from mbocp.problem.file.guess_table import GuessTable
from mbocp.problem.file.integrator_table import IntegratorTable
from mbocp.problem.file.kinds import RELEASED, SEVERAL, Duration, Rate, ViaTime
from mbocp.problem.file.limits_table import LimitsTable
from mbocp.problem.file.obstacle_table import ObstacleTable, SelfCollisionTable
from mbocp.problem.file.overrides import SHORT
from mbocp.problem.file.path_table import PathTable
from mbocp.problem.file.start_table import StartTable
from mbocp.problem.file.term_table import TermTable
from mbocp.problem.solver import SolverTable
from mbocp.robot.kinematics import WORLD
from mbocp.robot.loading.robot_keys import RobotKeys
from mbocp.terms.written import Finite, Positive, Triple, VectorOrNamed


def _named_robot(value: Any) -> Any:
    if isinstance(value, str):
        return {SHORT["robot"]: value}
    if not isinstance(value, Mapping):
        raise ValueError(f"got {show(value)}, expected a name, a path or a table with the key name")
    return value


def _named_solver(value: Any) -> Any:
    return {SHORT["solver"]: value} if isinstance(value, str) else value


class HorizonTable(Table):
    """How long, and in how many steps."""

    duration: Annotated[
        Duration,
        Key(
            "T; with a table it is [free](#free-duration); `guess` is their geometric mean if left out",
            "s",
            "required without `[[phase]]`",
        ),
    ] = None
    steps: Annotated[
        int | None,
        whole(1),
        Key(
            "N, impacts of phases included; as many as there is [memory](#how-many-steps) for",
            "",
            "required without `[[phase]]`",
        ),
    ] = None
    accuracy: Annotated[
        Finite | None,
        Key(
            "in place of `steps`: [steps are found](#accuracy-in-place-of-steps) whose errors are below it",
            "rad, m; part of the cost",
            takes="number from 1e-10 to 0.1",
        ),
    ] = None
    lengths: Annotated[
        list[Positive] | None,
        Key(
            "in place of `steps`: the length of each; their sum is the duration, which may be left out",
            "s",
            takes="list of numbers > 0",
        ),
    ] = None
    controls: Annotated[
        str,
        choice(CONTROLS),
        Key(
            "how controls vary [within a step](#controls-within-a-step); others than constant with `gauss2`, "
            "`gauss3`, `radau2`, `radau3`, `lobatto2`, `lobatto3`"
        ),
    ] = "constant"


class ViaTable(Table):
    """What holds at one node between start and end."""

    name: Annotated[
        str | None,
        Key("what a [via point](#via-points) is called; one table `[[via]]` each", "", "its number"),
    ] = None
    time: Annotated[
        ViaTime,
        Key(
            "when it holds: at the nearest node; or [when the motion passes it](#free-times)",
            "s",
            "`via.share`",
        ),
    ] = None
    share: Annotated[
        Finite | None,
        Key(
            "in place of a time; beside a free one the part of the steps that lead there",
            "part of the horizon",
            "`via.time`",
        ),
    ] = None
    q: Annotated[
        VectorOrNamed,
        Key(
            "configuration and velocity there",
            "m, rad; m/s, rad/s",
            "free",
            "like `goal.q` and `goal.v`",
            ("v",),
        ),
    ] = None
    v: Rate = None
    frame: Annotated[
        list[FrameGoalTable],
        SEVERAL,
        Key("poses of frames there: the keys of `goal.frame`, and tolerances", "", "nothing"),
    ] = Field(default_factory=list)


class HoldTable(Table):
    """A frame that is held throughout a phase."""

    name: Annotated[
        str | None, Key("what it is called; forces are called after it", "", "`frame` at `to`")
    ] = None
    frame: Annotated[str, Key("the frame that is held")]
    to: Annotated[str, Key("the frame that holds it")] = WORLD
    kind: Annotated[
        str,
        Key(
            'what is held: `"weld"` all of it, `"point"` its origin, `"hinge"` its origin and an axis, '
            '`"plane"`, '
            '`"line"` its origin in a plane or on a line, `"screw"` all but the way along a thread'
        ),
    ] = "weld"
    at: Annotated[
        str, Key('`"where_it_is"` relative to `to` when the hold begins, or where both frames `"coincide"`')
    ] = "where_it_is"
    axis: Annotated[
        Triple,
        Key(
            "of a hinge or screw in the axes of `frame`; normal of a plane and direction of a line in "
            "those of `to`",
            "",
            "`[0, 0, 1]`",
        ),
    ] = None
    pitch: Annotated[
        Finite | None, Key("of a screw: how far the frame slides along the axis in a turn", "m")
    ] = None
    meeting: Annotated[
        str,
        Key(
            'how it begins: with an `"impact"`, or `"soft"`, with velocities that fit; of a hold that goes '
            "on "
            "nothing"
        ),
    ] = "impact"


class ReleaseTable(Table):
    """A constraint of the robot that does not hold in a phase."""

    name: Annotated[str, Key("the constraint that does not hold")]
    meeting: Annotated[str, Key("how it is taken on again")] = "impact"


class PhaseTable(Table):
    """A run of steps, and what differs in it."""

    name: Annotated[
        str,
        Key("what a [phase](phases.md) is called; one table `[[phase]]` each, in the place of `[horizon]`"),
    ]
    steps: Annotated[
        int,
        whole(1),
        Key("number of its steps that take time; with `horizon.accuracy` those with which the search begins"),
    ]
    duration: Annotated[Duration, Key("how long it takes: given, or found between `min` and `max`", "s")]
    limits: Annotated[
        LimitsTable,
        Key(
            "keys of `[limits]` that hold in it, component by component in the place of the problem's",
            "",
            "those of the problem",
        ),
    ] = LimitsTable.model_construct()
    cost: Annotated[
        PhaseCostTable,  # type: ignore[valid-type]  # made of its terms
        Key(
            f"weights in it: {', '.join(f'`{key}`' for key in PhaseCostTable.model_fields)}",
            "",
            "that of the problem",
        ),
    ] = PhaseCostTable.model_construct()
    hold: Annotated[
        list[HoldTable],
        SEVERAL,
        Key("[frames that are held](phases.md#what-is-held) throughout: with the keys of the next rows"),
    ] = Field(default_factory=list)
    release: Annotated[
        list[ReleaseTable],
        RELEASED,
        Key(
            'names of constraints of the robot that do not hold; as `{ name = string, meeting = "soft" }` '
            "with the "
            "way in which they are taken on again"
        ),
    ] = Field(default_factory=list)
    path: Annotated[
        list[PathTable],  # type: ignore[valid-type]
        Key("path constraints in it, with the keys of `[[path]]`; `from` and `until` are parts of the phase"),
    ] = Field(default_factory=list)
    via: Annotated[
        list[ViaTable],
        Key("via points at its end, with the keys of `[[via]]` but `time`; `share` is a part of the phase"),
    ] = Field(default_factory=list)


class ProblemTable(Table):
    """A whole problem file."""

    robot: Annotated[
        RobotKeys,
        Kind("string or table", _named_robot, str),
        Key("name or path; or a table with the keys below"),
    ]
    coordinates: Annotated[
        str,
        choice(COORDINATES),
        Key(
            "what the unknowns are: displacements of joints, or positions and directors of bodies: "
            "[Natural coordinates](natural_coordinates.md)"
        ),
    ] = "joint"
    horizon: Annotated[HorizonTable, Key("how long, and in how many steps")] = HorizonTable.model_construct()
    phase: Annotated[list[PhaseTable], Key("[phases](phases.md) of the motion")] = Field(default_factory=list)
    start: Annotated[StartTable, Key("state at t = 0")] = StartTable.model_construct()
    goal: Annotated[GoalTable, Key("state at t = T")] = GoalTable.model_construct()
    cost: Annotated[CostTable, Key("what is minimised")] = CostTable.model_construct()  # type: ignore[valid-type]
    limits: Annotated[LimitsTable, Key("bounds along the motion")] = LimitsTable.model_construct()
    via: Annotated[list[ViaTable], Key("[via points](#via-points)")] = Field(default_factory=list)
    path: Annotated[
        list[PathTable],  # type: ignore[valid-type]
        Key("[path constraints](#path-constraints)"),
    ] = Field(default_factory=list)
    obstacle: Annotated[list[ObstacleTable], Key("[obstacles](obstacles.md)")] = Field(default_factory=list)
    self_collision: Annotated[
        bool | SelfCollisionTable | None,
        Key("whether links [keep apart from each other](obstacles.md#self-collision)", "", "false"),
    ] = None
    terms: Annotated[list[TermTable], Key("[terms of one's own](terms.md)")] = Field(default_factory=list)  # type: ignore[valid-type]
    guess: Annotated[GuessTable, Key("where the solver starts")] = GuessTable.model_construct()
    integrator: Annotated[IntegratorTable, Key("how time is discretised")] = IntegratorTable.model_construct()
    solver: Annotated[
        SolverTable,
        Kind("string or table", _named_solver, str),
        Key(
            "a method's name, or a table with the keys below; also `mbocp solve --solver NAME`",
            "",
            '`"auto"`',
        ),
    ] = SolverTable.model_construct()


def problem_schema() -> dict[str, Any]:
    """Return the JSON schema of problem files: editors complete keys by it, and check them."""
    about = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "problem file of mbocp"}
    return {**json_schema_of(ProblemTable), **about}


def checked_tables(document: Mapping[str, Any]) -> dict[str, Any]:
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
