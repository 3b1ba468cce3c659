"""A `Problem` as the tables of a problem file, and tables as TOML."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from mbocp._arrays import Array, BoolArray, plain
from mbocp.integrators import SCHEMES
from mbocp.problem.cost import Cost
from mbocp.problem.data import ProblemData
from mbocp.problem.file.frame_table import frame_tables
from mbocp.problem.file.named_values import joint_values
from mbocp.problem.file.obstacle_table import obstacle_tables, self_collision_table
from mbocp.problem.file.path_table import path_tables
from mbocp.problem.file.periodic_table import free_table, periodic_table
from mbocp.problem.file.phase_table import phase_tables, written_limits
from mbocp.problem.file.term_table import term_tables
from mbocp.problem.file.via_table import via_tables
from mbocp.problem.goals.goal import Goal
from mbocp.problem.guess import Guess
from mbocp.problem.timeline.times import written_duration
from mbocp.robot import Robot
from mbocp.terms import COST_TERMS


def tables_of(problem: ProblemData) -> dict[str, Any]:
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


def _steps(problem: ProblemData) -> dict[str, Any]:
    """What says which steps there are."""
    if problem.accuracy is not None:
        return {"accuracy": problem.accuracy}
    return {"steps": problem.num_steps} if problem.lengths is None else {"lengths": problem.lengths}


def written_tables(problem: ProblemData) -> dict[str, Any]:
    """Tables of a problem as they are read from its file: without what is None, and without empty tables."""
    return {name: table for name, table in _without_none(plain(tables_of(problem))).items() if table != {}}


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(entry) for key, entry in value.items() if entry is not None}
    return [_without_none(entry) for entry in value] if isinstance(value, list) else value


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


def _integrator(problem: ProblemData) -> dict[str, Any]:
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
