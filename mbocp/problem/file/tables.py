"""A `Problem` as the tables of a problem file, and tables as TOML."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeAlias

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.integrators import SCHEMES
from mbocp.problem.contact_bounds import ContactBounds
from mbocp.problem.contact_force import ContactForce
from mbocp.problem.cost import Cost
from mbocp.problem.file.frame_table import frame_tables
from mbocp.problem.file.named_values import joint_values
from mbocp.problem.file.obstacle_table import obstacle_tables, self_collision_table
from mbocp.problem.file.path_table import path_tables
from mbocp.problem.file.periodic_table import free_table, periodic_table
from mbocp.problem.file.phase_table import phase_tables, written_limits
from mbocp.problem.file.term_table import term_tables
from mbocp.problem.file.via_table import via_tables
from mbocp.problem.goals.free_start import FreeStart
from mbocp.problem.goals.goal import Goal
from mbocp.problem.guess import Guess
from mbocp.problem.integration import Stabilisation
from mbocp.problem.limits import Bounds
from mbocp.problem.obstacles.clearance import Clearance, SelfCollision
from mbocp.problem.path import PathConstraint
from mbocp.problem.solver import SolverOptions
from mbocp.problem.timeline.duration import written_duration
from mbocp.problem.timeline.meeting import Meeting
from mbocp.problem.timeline.named_phase import NamedPhase
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.timeline.via_constraint import ViaConstraint
from mbocp.robot import Robot
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.terms import COST_TERMS, FrameTolerance, OwnPathConstraint, OwnTerm

PathObject: TypeAlias = (
    ContactForce | ContactBounds | OwnPathConstraint | FrameTolerance | ViaConstraint | Clearance | Meeting
)

__all__ = ["ProblemFields", "tables_of", "to_toml"]


class ProblemFields(Protocol):
    """The fields of `Problem`: it writes and changes itself by this package, which knows no more of it."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    # fmt: off
    @property
    def cost(self) -> Cost: ...  # noqa: D102
    @property
    def duration(self) -> float: ...  # noqa: D102
    @property
    def duration_range(self) -> tuple[float, float] | None: ...  # noqa: D102
    @property
    def num_steps(self) -> int: ...  # noqa: D102
    @property
    def lengths(self) -> Array | None: ...  # noqa: D102
    @property
    def accuracy(self) -> float | None: ...  # noqa: D102
    @property
    def controls(self) -> str: ...  # noqa: D102
    @property
    def phase(self) -> tuple[NamedPhase, ...]: ...  # noqa: D102
    @property
    def robot(self) -> Robot: ...  # noqa: D102
    @property
    def coordinates(self) -> str: ...  # noqa: D102
    @property
    def scheme(self) -> str: ...  # noqa: D102
    @property
    def chooses_scheme(self) -> bool: ...  # noqa: D102
    @property
    def lie(self) -> str: ...  # noqa: D102
    @property
    def substeps(self) -> int: ...  # noqa: D102
    @property
    def stabilisation(self) -> Stabilisation: ...  # noqa: D102
    @property
    def goal(self) -> Goal: ...  # noqa: D102
    @property
    def goals(self) -> tuple[Goal, ...]: ...  # noqa: D102
    @property
    def limits(self) -> Bounds: ...  # noqa: D102
    @property
    def via(self) -> tuple[ViaPoint, ...]: ...  # noqa: D102
    @property
    def path(self) -> tuple[PathConstraint | PathObject, ...]: ...  # noqa: D102
    @property
    def obstacle(self) -> tuple[Obstacle, ...]: ...  # noqa: D102
    @property
    def self_collision(self) -> SelfCollision | bool | None: ...  # noqa: D102
    @property
    def terms(self) -> tuple[OwnTerm, ...]: ...  # noqa: D102
    @property
    def q_start(self) -> Array: ...  # noqa: D102
    @property
    def v_start(self) -> Array: ...  # noqa: D102
    @property
    def a_start(self) -> Array: ...  # noqa: D102
    @property
    def start_free(self) -> FreeStart | None: ...  # noqa: D102
    @property
    def guess(self) -> Guess: ...  # noqa: D102
    @property
    def solver(self) -> SolverOptions: ...  # noqa: D102
    @property
    def source(self) -> Path | None: ...  # noqa: D102
    @property
    def name(self) -> str: ...  # noqa: D102
    # fmt: on


def tables_of(problem: ProblemFields) -> dict[str, Any]:
    """Return the tables of a problem file that loads as the same problem.

    Everything is written out: overrides and defaults are resolved, a target file becomes numbers, and paths
    are absolute.
    """
    robot = problem.robot
    return {
        "coordinates": problem.coordinates,
        "phase": phase_tables(problem.phase) or None,
        "via": via_tables(robot, problem.via) or None,
        "path": path_tables(robot, problem.path) or None,
        "obstacle": obstacle_tables(problem.obstacle) or None,
        "self_collision": self_collision_table(problem.self_collision),
        "terms": term_tables(robot, problem.terms) or None,
        "robot": dict(robot.spec),
        "horizon": {
            "duration": written_duration(problem.duration, problem.duration_range),
            **_steps(problem),
            **({"controls": problem.controls} if problem.controls != "constant" else {}),
        },
        "start": {
            "q": problem.q_start,
            "v": problem.v_start,
            "a": problem.a_start if problem.a_start.any() else None,
            "free": free_table(robot, problem.start_free),
        },
        "goal": {"any": [_goal(goal, robot, problem.scheme) for goal in problem.goals]}
        if problem.goals
        else _goal(problem.goal, robot, problem.scheme),
        "cost": _cost(problem.cost),
        "guess": _guess(problem.guess),
        "limits": written_limits(problem.limits),
        "integrator": _integrator(problem),
        "solver": asdict(problem.solver),
    }


def _steps(problem: ProblemFields) -> dict[str, Any]:
    """What says which steps there are."""
    if problem.accuracy is not None:
        return {"accuracy": problem.accuracy}
    return {"steps": problem.num_steps} if problem.lengths is None else {"lengths": problem.lengths}


def to_toml(document: Mapping[str, Any]) -> str:
    """Return `document` as TOML: plain keys first, then one `[table]` after the other; None is left out."""
    plain = [(key, value) for key, value in document.items() if not isinstance(value, Mapping)]
    lines = [f"{_key(key)} = {_value(value)}" for key, value in plain if value is not None]
    for name, table in document.items():
        if isinstance(table, Mapping) and table:
            lines += ["", f"[{_key(name)}]"]
            lines += [f"{_key(key)} = {_value(value)}" for key, value in table.items() if value is not None]
    return "\n".join(lines).lstrip("\n") + "\n"


def _goal(goal: Goal, robot: Robot, scheme: str) -> dict[str, Any]:
    table: dict[str, Any] = {"enforce": goal.enforce}
    options = {"guard": goal.guard, "redundant": goal.redundant}
    table |= {key: value for key, value in options.items() if SCHEMES[scheme].takes(f"goal.{key}")}
    for key, value, active in (("q", goal.q, goal.q_active), (goal.rate, goal.value, goal.rate_active)):
        if active.any():
            table[key] = _written(robot, value, active)
    if goal.a_rule == "free":
        table["a"] = "free"
    elif goal.a_active.any() and goal.a_rule == "given":
        table["a"] = _written(robot, goal.a, goal.a_active)
    if goal.periodic is not None:
        table["periodic"] = periodic_table(goal.periodic)
    if goal.frames:
        table["frame"] = frame_tables(goal.frames)
    return table


def _written(robot: Robot, value: Array, active: BoolArray) -> Any:
    return value if active.all() else joint_values(robot, value, active)


def _cost(cost: Cost) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for term in COST_TERMS:
        table |= term.write(cost)
    return table


def _integrator(problem: ProblemFields) -> dict[str, Any]:
    options = {"lie": problem.lie, "substeps": problem.substeps, **asdict(problem.stabilisation)}
    taken = {key: v for key, v in options.items() if SCHEMES[problem.scheme].takes(f"integrator.{key}")}
    return {"scheme": problem.scheme, **taken}


def _guess(guess: Guess) -> dict[str, Any]:
    file = str(guess.path.resolve()) if guess.path else None
    return {"kind": guess.kind, "u": guess.u, "q": guess.q, "file": file, "at": guess.at}


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def _value(value: Any) -> str:
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_value(entry) for entry in value) + "]"
    return json.dumps(str(value), ensure_ascii=False)
