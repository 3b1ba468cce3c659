"""The problem file as pydantic models: which keys there are and what kind of value each takes.

Only the shape of the file is checked here. What depends on the robot (lengths, joint names) is checked when
the values are resolved, what depends on the mathematics when the `Problem` is made: once, for files and for
Python.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, TypeAlias

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from mbocp._text import shown
from mbocp.problem.integration import Stabilisation
from mbocp.problem.numbers import as_float, finite_number, is_number
from mbocp.problem.options import SolverOptions

__all__ = [
    "CostTable",
    "GoalTable",
    "GuessTable",
    "HorizonTable",
    "IntegratorTable",
    "LimitsTable",
    "PathTable",
    "ProblemTable",
    "RobotTable",
    "SolverTable",
    "StartTable",
    "TargetTable",
    "WeightsTable",
]

Vector: TypeAlias = list[float]
Named: TypeAlias = dict[str, float | list[float]]
Limit: TypeAlias = float | list[float]


def _vector(value: Any, where: str = "") -> Vector:
    return [finite_number(entry, f" at index {i}{where}") for i, entry in enumerate(value)]


def _named(value: Mapping[str, Any]) -> Named:
    return {
        name: _vector(entry, f" for {shown(name)}")
        if isinstance(entry, list)
        else finite_number(entry, f" for {shown(name)}")
        for name, entry in value.items()
    }


def _vector_or_named(value: Any) -> Vector | Named:
    if isinstance(value, list):
        return _vector(value)
    if isinstance(value, Mapping):
        return _named(value)
    raise ValueError(f"got {shown(value)}, expected a list of numbers or a table by joint name")


def _rate(value: Any) -> Vector | Named | float:
    """Velocities or momenta; 0 says that all of them are."""
    if is_number(value) and value == 0:
        return 0.0
    if is_number(value):
        raise ValueError(
            f"got {shown(value)}, expected a list of numbers, a table by joint name, or 0 for rest"
        )
    return _vector_or_named(value)


def _trajectory_or_vector(value: Any) -> list[Vector] | Vector | Named:
    if isinstance(value, list) and value and all(isinstance(row, list) for row in value):
        return [_vector(row, f" of row {n}") for n, row in enumerate(value)]
    return _vector_or_named(value)


def _control(value: Any) -> float | Vector | Named:
    if isinstance(value, (list, Mapping)):
        return _vector_or_named(value)
    return finite_number(value)


def _bound(value: Any, where: str = "") -> float:
    if not is_number(value) or math.isnan(value):
        raise ValueError(f"got {shown(value)}{where}, expected a number (inf for no limit)")
    return as_float(value)


def _pair(value: Any, where: str = "") -> list[float]:
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"got {shown(value)}{where}, expected [lower, upper]")
    return [_bound(side, where) for side in value]


def _limit(value: Any, where: str = "") -> Limit:
    return _pair(value, where) if isinstance(value, list) else _bound(value, where)


def _limits(value: Any) -> bool | float | list[Limit] | dict[str, Limit]:
    if isinstance(value, bool):
        return value
    if isinstance(value, list):
        return [_limit(entry, f" at index {i}") for i, entry in enumerate(value)]
    if isinstance(value, Mapping):
        return {name: _limit(entry, f" for {shown(name)}") for name, entry in value.items()}
    if isinstance(value, str):
        raise ValueError(f"got {shown(value)}, expected true, a number, a list or a table by name")
    return _bound(value)


def _ranges(value: Any) -> bool | list[list[float]] | dict[str, list[float]]:
    if isinstance(value, bool):
        return value
    if isinstance(value, list):
        return [_pair(entry, f" at index {i}") for i, entry in enumerate(value)]
    if isinstance(value, Mapping):
        return {name: _pair(entry, f" for {shown(name)}") for name, entry in value.items()}
    raise ValueError(
        f"got {shown(value)}, expected true, a list of [lower, upper] or a table of them by name"
    )


def _lock(value: Any) -> list[str] | Named:
    if isinstance(value, list) and all(isinstance(name, str) for name in value):
        return value
    if isinstance(value, Mapping):
        return _named(value)
    raise ValueError(
        f"got {shown(value)}, expected a list of joint names or a table with a position for each"
    )


def _named_robot(value: Any) -> Any:
    if isinstance(value, str):
        return {"name": value}
    if not isinstance(value, Mapping):
        raise ValueError(f"got {shown(value)}, expected a name, a path or a table with the key name")
    return value


def _named_solver(value: Any) -> Any:
    return {"method": value} if isinstance(value, str) else value


def _listed_weights(value: Any) -> Any:
    return {"qp": value} if isinstance(value, list) else value


VectorOrNamed = Annotated[Any, BeforeValidator(_vector_or_named)]
Rate = Annotated[Any, BeforeValidator(_rate)]
TrajectoryOrVector = Annotated[Any, BeforeValidator(_trajectory_or_vector)]
Lock = Annotated[Any, BeforeValidator(_lock)]
Control = Annotated[Any, BeforeValidator(_control)]
Finite = Annotated[float, BeforeValidator(finite_number)]
Limits = Annotated[Any, BeforeValidator(_limits)]
Ranges = Annotated[Any, BeforeValidator(_ranges)]
Range = Annotated[Any, BeforeValidator(_pair)]
Bound = Annotated[Any, BeforeValidator(_bound)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class RobotTable(_Table):
    """Which robot, and how it is loaded: what `mbocp.robot.robot_from_spec` takes."""

    name: str
    free_flyer: bool | None = None
    lock: Lock = None
    gravity: list[Finite] | None = Field(default=None, min_length=3, max_length=3)
    actuated: list[str] | None = None
    mimic: bool | None = None
    damping: bool | None = None
    friction: str | None = None
    friction_speed: Finite | None = None
    rotations: str | None = None
    label: str | None = None
    package_dirs: list[str] | None = None


class HorizonTable(_Table):
    """How long, and in how many steps."""

    duration: Finite
    steps: int


class StartTable(_Table):
    """State at t = 0."""

    q: VectorOrNamed = None
    v: Rate = None
    p: Rate = None
    assemble: bool = False


class GoalTable(_Table):
    """State at t = T."""

    q: VectorOrNamed = None
    v: Rate = None
    p: Rate = None
    assemble: bool = False
    enforce: str | None = None
    guard: bool = True
    redundant: str = "drop"


class TargetTable(_Table):
    """What the running cost tracks."""

    q: TrajectoryOrVector = None
    p: TrajectoryOrVector = None


class WeightsTable(_Table):
    """Diagonal weights on (q, p): one list, or `q` and `p` apart."""

    qp: VectorOrNamed = None
    q: Control = None
    p: Control = None


Weights = Annotated[WeightsTable, BeforeValidator(_listed_weights)]


class CostTable(_Table):
    """What is minimised."""

    effort: Control = 1.0
    control_rate: Control = 0.0
    velocity: Control = None
    potential: Finite = 0.0
    tracking: Finite = 0.0
    tracking_weights: Weights | None = None
    target: TargetTable | None = None
    target_file: str | None = None
    terminal: Finite = 0.0
    terminal_weights: Weights | None = None


class LimitsTable(_Table):
    """Bounds that hold along the motion; what is left out is not bounded."""

    effort: Limits = None
    velocity: Limits = None
    position: Ranges = None


class PathTable(_Table):
    """One constraint on a frame that holds along the motion."""

    name: str | None = None
    kind: str
    frame: str
    frame_b: str | None = None
    point: list[Finite] | None = Field(default=None, min_length=3, max_length=3)
    x: Range = None
    y: Range = None
    z: Range = None
    min: Bound = None
    max: Bound = None


class GuessTable(_Table):
    """Where the solver starts."""

    kind: str | None = None
    u: Control = None
    file: str | None = None


class IntegratorTable(_Table):
    """How time is discretised."""

    scheme: str = "se1"
    lie: str = "munthe_kaas"
    substeps: int = 1
    gamma_quaternion: Finite = Stabilisation.gamma_quaternion
    gamma_dcm: Finite = Stabilisation.gamma_dcm
    gamma_constraint: Finite = Stabilisation.gamma_constraint


class SolverTable(_Table):
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


class ProblemTable(_Table):
    """A whole problem file."""

    robot: Annotated[RobotTable, BeforeValidator(_named_robot)]
    coordinates: str = "joint"
    horizon: HorizonTable
    start: StartTable = StartTable()
    goal: GoalTable = GoalTable()
    cost: CostTable = CostTable()
    limits: LimitsTable = LimitsTable()
    path: list[PathTable] = Field(default_factory=list)
    guess: GuessTable = GuessTable()
    integrator: IntegratorTable = IntegratorTable()
    solver: Annotated[SolverTable, BeforeValidator(_named_solver)] = SolverTable()
