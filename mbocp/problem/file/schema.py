"""The problem file as pydantic models: which keys there are and what kind of value each takes.

Only the shape of the file is checked here. What depends on the robot (lengths, joint names) is checked when
the values are resolved, what depends on the mathematics when the `Problem` is made: once, for files and for
Python.

Defaults that are tables are made by `model_construct`, which asks for no validator: pydantic takes several
milliseconds to build one, and that of the whole file has all in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any, TypeAlias

from pydantic import BeforeValidator, Field, create_model

from mbocp._numbers import finite_number, is_number
from mbocp._text import shown
from mbocp.problem.cost import weights_by_key
from mbocp.problem.integration import Stabilisation
from mbocp.problem.solver import SolverOptions
from mbocp.robot.collision.obstacle import SMOOTHING
from mbocp.robot.kinematics import WORLD
from mbocp.robot.loading.robot_keys import RobotKeys
from mbocp.terms import COST_TERMS, PATH_KEYS
from mbocp.terms.span import SpanKeys
from mbocp.terms.written import (
    Bound,
    Control,
    Finite,
    Named,
    Table,
    Vector,
    VectorOrNamed,
    VectorOrNumber,
    merged,
    range_of,
    sided,
    vector_or_named,
)

Limit: TypeAlias = float | list[float]


def _rate(value: Any) -> Vector | Named | float:
    """Velocities or momenta; 0 means that all are zero."""
    if is_number(value) and value == 0:
        return 0.0
    if is_number(value):
        raise ValueError(
            f"got {shown(value)}, expected 0 for rest, a list of as many numbers as mbocp robots NAME "
            "counts for v, or a table by joint name such as { elbow_joint = 0.5 }"
        )
    return vector_or_named(value)


def _rate_or_free(value: Any) -> Any:
    """Accelerations at the end, or that nothing is asked of them."""
    return value if value == "free" else _rate(value)


def _listed(value: Any) -> Any:
    """One table, or several."""
    return [value] if isinstance(value, Mapping) else value


def _released(value: Any) -> Any:
    """Names of constraints, or tables with more."""
    entries = [value] if isinstance(value, (str, Mapping)) else value
    if not isinstance(entries, list):
        return entries
    return [{"name": entry} if isinstance(entry, str) else entry for entry in entries]


def _triple_or_zero(value: Any) -> Any:
    """Three numbers; 0 means that all are zero."""
    return [0.0, 0.0, 0.0] if is_number(value) and value == 0 else value


def _limit(value: Any, where: str = "") -> Limit:
    return range_of(value, where) if isinstance(value, list) else sided(value, where)


def _limits(value: Any) -> bool | float | list[Limit] | dict[str, Limit]:
    if isinstance(value, bool):
        return value
    if isinstance(value, list):
        return [_limit(entry, f" at index {i}") for i, entry in enumerate(value)]
    if isinstance(value, Mapping):
        return {name: _limit(entry, f" for {shown(name)}") for name, entry in value.items()}
    if isinstance(value, str):
        raise ValueError(f"got {shown(value)}, expected true, a number, a list or a table by name")
    return sided(value)


def _ranges(value: Any) -> bool | list[list[float]] | dict[str, list[float]]:
    if isinstance(value, bool):
        return value
    if isinstance(value, list):
        return [range_of(entry, f" at index {i}") for i, entry in enumerate(value)]
    if isinstance(value, Mapping):
        return {name: range_of(entry, f" for {shown(name)}") for name, entry in value.items()}
    raise ValueError(
        f"got {shown(value)}, expected true, a list of [lower, upper] or a table of them by name"
    )


def _duration(value: Any) -> float | dict[str, float] | None:
    if value is None:
        return None
    if isinstance(value, Mapping):
        return {name: finite_number(entry, f" for {shown(name)}") for name, entry in value.items()}
    return finite_number(value)


def _via_time(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {
            name: entry if name == "phase" else finite_number(entry, f" for {shown(name)}")
            for name, entry in value.items()
        }
    return value if value is None or isinstance(value, str) else finite_number(value)


def _free(value: Any) -> Any:
    if value is None or value is True or value in ("q", "v") or isinstance(value, Mapping):
        return value
    raise ValueError(
        f'got {shown(value)}, expected true, "q", "v" or a table with q and v such as '
        '{ v = true, q = ["elbow"] }'
    )


def _periodic(value: Any) -> Any:
    if value is None or value is True or isinstance(value, Mapping):
        return value
    raise ValueError(
        f"got {shown(value)}, expected true, or a table with swap, mirror, combine, moved, except, impact"
    )


def _named_robot(value: Any) -> Any:
    if isinstance(value, str):
        return {"name": value}
    if not isinstance(value, Mapping):
        raise ValueError(f"got {shown(value)}, expected a name, a path or a table with the key name")
    return value


def _named_solver(value: Any) -> Any:
    return {"method": value} if isinstance(value, str) else value


Rate = Annotated[Any, BeforeValidator(_rate)]
RateOrFree = Annotated[Any, BeforeValidator(_rate_or_free)]
Triple = Annotated[list[Finite] | None, Field(min_length=3, max_length=3)]
TripleOrZero = Annotated[Triple, BeforeValidator(_triple_or_zero)]
Limits = Annotated[Any, BeforeValidator(_limits)]
Duration = Annotated[Any, BeforeValidator(_duration)]
Ranges = Annotated[Any, BeforeValidator(_ranges)]
Free = Annotated[Any, BeforeValidator(_free)]
PeriodicWords = Annotated[Any, BeforeValidator(_periodic)]
ViaTime = Annotated[Any, BeforeValidator(_via_time)]


class HorizonTable(Table):
    """How long, and in how many steps."""

    duration: Duration = None
    steps: int | None = None
    accuracy: Finite | None = None
    lengths: list[Finite] | None = None
    controls: str = "constant"


class FramePoseTable(Table):
    """Pose of a frame, or parts of it."""

    name: str
    position: Triple = None
    x: Finite | None = None
    y: Finite | None = None
    z: Finite | None = None
    orientation: list[Finite] | None = Field(default=None, min_length=4, max_length=4)
    rpy: Triple = None
    axis: Triple = None
    direction: Triple = None
    relative_to: str | None = None


class StartTable(Table):
    """State at t = 0."""

    q: VectorOrNamed = None
    v: Rate = None
    p: Rate = None
    a: Rate = None
    frame: Annotated[list[FramePoseTable], BeforeValidator(_listed)] = Field(default_factory=list)
    assemble: bool = False
    free: Free = None


class FrameGoalTable(FramePoseTable):
    """Pose and velocity of a frame at t = T, or parts of them."""

    velocity: TripleOrZero = None
    angular_velocity: TripleOrZero = None
    position_tolerance: VectorOrNumber = None
    orientation_tolerance: Finite | None = None
    weight: Finite | None = None


class GoalMemberTable(Table):
    """State at t = T, one of several."""

    q: VectorOrNamed = None
    v: Rate = None
    p: Rate = None
    a: RateOrFree = None
    frame: Annotated[list[FrameGoalTable], BeforeValidator(_listed)] = Field(default_factory=list)
    assemble: bool = False
    periodic: PeriodicWords = None
    enforce: str | None = None
    guard: bool = True
    redundant: str = "drop"


class ViaTable(Table):
    """What holds at one node between start and end."""

    name: str | None = None
    time: ViaTime = None
    share: Finite | None = None
    q: VectorOrNamed = None
    v: Rate = None
    frame: Annotated[list[FrameGoalTable], BeforeValidator(_listed)] = Field(default_factory=list)


class GoalTable(GoalMemberTable):
    """State at t = T; beside several that are given, what is common to them."""

    any: list[GoalMemberTable] = Field(default_factory=list)


CostTable = merged(
    "CostTable", "What is minimised: the keys of all terms.", (t.Keys for t in COST_TERMS), Table
)


class LimitsTable(Table):
    """Bounds along the motion; components that are left out have none."""

    effort: Limits = None
    velocity: Limits = None
    position: Ranges = None
    acceleration: Limits = None
    jerk: Limits = None
    effort_rate: Limits = None
    power: Limits = None


class PathHead(Table):
    """Keys that every path constraint has."""

    name: str | None = None
    kind: str
    frame: str | None = None


PathTable = merged(
    "PathTable",
    "One constraint on a frame or a force that holds along the motion: the keys of all kinds.",
    (*PATH_KEYS.values(), SpanKeys),
    PathHead,
)


PhaseCostTable = merged(
    "PhaseCostTable", "Weights that differ in a phase.", (t.Keys for t in weights_by_key().values()), Table
)


class HoldTable(Table):
    """A frame that is held throughout a phase."""

    name: str | None = None
    frame: str
    to: str = WORLD
    kind: str = "weld"
    at: str = "where_it_is"
    axis: Triple = None
    pitch: Finite | None = None
    meeting: str = "impact"


class ReleaseTable(Table):
    """A constraint of the robot that does not hold in a phase."""

    name: str
    meeting: str = "impact"


class PhaseTable(Table):
    """A run of steps, and what differs in it."""

    name: str
    steps: int
    duration: Duration
    limits: LimitsTable = LimitsTable.model_construct()
    cost: PhaseCostTable = PhaseCostTable.model_construct()  # type: ignore[valid-type]  # made of its terms
    hold: Annotated[list[HoldTable], BeforeValidator(_listed)] = Field(default_factory=list)
    release: Annotated[list[ReleaseTable], BeforeValidator(_released)] = Field(default_factory=list)
    path: list[PathTable] = Field(default_factory=list)  # type: ignore[valid-type]
    via: list[ViaTable] = Field(default_factory=list)


class TermHead(Table):
    """Keys of a term of one's own."""

    name: str
    role: str
    digest: str
    weight: Finite | None = None
    unit: str | None = None
    lower: list[Bound] | None = None
    upper: list[Bound] | None = None
    parameters: dict[str, VectorOrNumber] = Field(default_factory=dict)


TermTable = merged(
    "TermTable",
    "What the text of a problem says of a term of one's own, whose function it does not hold.",
    (SpanKeys,),
    TermHead,
)


class ObstacleTable(Table):
    """A shape that links keep away from."""

    name: str | None = None
    shape: str
    radius: Finite | None = None
    length: Finite | None = None
    size: Triple = None
    file: str | None = None
    scale: Finite | list[Finite] | None = None
    hull: bool = False
    vertices: list[list[Finite]] | None = None
    position: Triple = None
    rpy: Triple = None
    orientation: list[Finite] | None = Field(default=None, min_length=4, max_length=4)
    frame: str | None = None
    margin: Finite = 0.0
    smoothing: Finite = SMOOTHING
    movable: bool = False


class SelfCollisionTable(Table):
    """How links keep away from each other."""

    margin: Finite = 0.0
    disabled: list[list[str]] = Field(default_factory=list)
    srdf: str | None = None


class GuessTable(Table):
    """Where the solver starts."""

    kind: str | None = None
    u: Control = None
    q: list[VectorOrNamed] | None = None
    file: str | None = None
    at: float | None = None


class IntegratorTable(Table):
    """How time is discretised."""

    scheme: str = "auto"
    lie: str = "munthe_kaas"
    substeps: int = 1
    gamma_quaternion: Finite = Stabilisation.gamma_quaternion
    gamma_dcm: Finite = Stabilisation.gamma_dcm
    gamma_constraint: Finite = Stabilisation.gamma_constraint


class SolverTable(Table):
    """How the problem is solved; the defaults are those of `SolverOptions`."""

    method: str = SolverOptions.method
    globalisation: str = SolverOptions.globalisation
    tolerance: Finite = SolverOptions.tolerance
    max_iterations: int | None = SolverOptions.max_iterations
    hessian: str = SolverOptions.hessian
    adjoint: str = SolverOptions.adjoint
    loop: str = SolverOptions.loop
    theta_max: Finite = SolverOptions.theta_max
    switch_residual: Finite = SolverOptions.switch_residual
    switch_cost: Finite = SolverOptions.switch_cost
    switch_iterations: int = SolverOptions.switch_iterations
    time_limit: Finite | None = SolverOptions.time_limit
    linear_solver: str = SolverOptions.linear_solver
    starts: int = SolverOptions.starts
    seed: int = SolverOptions.seed
    threads: int | str = SolverOptions.threads


class ProblemTable(Table):
    """A whole problem file."""

    robot: Annotated[RobotKeys, BeforeValidator(_named_robot)]
    coordinates: str = "joint"
    horizon: HorizonTable = HorizonTable.model_construct()
    phase: list[PhaseTable] = Field(default_factory=list)
    start: StartTable = StartTable.model_construct()
    goal: GoalTable = GoalTable.model_construct()
    cost: CostTable = CostTable.model_construct()  # type: ignore[valid-type]  # made of its terms
    limits: LimitsTable = LimitsTable.model_construct()
    via: list[ViaTable] = Field(default_factory=list)
    path: list[PathTable] = Field(default_factory=list)  # type: ignore[valid-type]
    obstacle: list[ObstacleTable] = Field(default_factory=list)
    self_collision: bool | SelfCollisionTable | None = None
    terms: list[TermTable] = Field(default_factory=list)  # type: ignore[valid-type]
    guess: GuessTable = GuessTable.model_construct()
    integrator: IntegratorTable = IntegratorTable.model_construct()
    solver: Annotated[SolverTable, BeforeValidator(_named_solver)] = SolverTable.model_construct()


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
