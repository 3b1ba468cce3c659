"""A `Problem` as the tables of a problem file, and tables as TOML."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from mbocp._arrays import plain
from mbocp.problem.file.cost_table import write_cost
from mbocp.problem.file.goal_table import write_goal
from mbocp.problem.file.limits_table import write_limits
from mbocp.problem.file.obstacle_table import write_self_collision
from mbocp.problem.file.path_table import path_tables
from mbocp.problem.file.phase_table import write_phase
from mbocp.problem.file.robust_table import write_parameter, write_robust
from mbocp.problem.file.scheme_tables import write_guess, write_integrator
from mbocp.problem.file.start_tables import write_start, write_via
from mbocp.problem.file.term_table import write_term
from mbocp.problem.free_contact_bounds import FreeContactBounds
from mbocp.problem.problem_data import ProblemData
from mbocp.problem.timeline.times import write_duration
from mbocp.robot import Robot
from mbocp.terms.bounded import BoundedTerm


def tables_of(problem: ProblemData) -> dict[str, Any]:
    """Return the tables of a problem file that loads as the same problem.

    Everything is written out: overrides and defaults are resolved, a target file becomes numbers, and paths
    are absolute.
    """
    robot = problem.robot
    ground, path = _write_free(robot, problem.path)
    return {
        "coordinates": problem.coordinates,
        "phase": [write_phase(phase) for phase in problem.phase] or None,
        "via": [write_via(robot, point) for point in problem.via] or None,
        "path": path_tables(robot, path) or None,
        "ground": ground,
        "obstacle": [obstacle.table for obstacle in problem.obstacle] or None,
        "self_collision": write_self_collision(problem.self_collision),
        "terms": [write_term(robot, term) for term in problem.terms] or None,
        "parameter": [write_parameter(one) for one in problem.parameter] or None,
        "robot": dict(robot.spec),
        "horizon": {
            "duration": write_duration(problem.duration, problem.duration_range),
            **_steps(problem),
            **({"controls": problem.controls} if problem.controls != "constant" else {}),
        },
        "start": write_start(problem),
        "goal": write_goal(problem),
        "cost": write_cost(problem.cost),
        "guess": write_guess(problem.guess),
        "limits": write_limits(problem.limits),
        "robust": write_robust(problem.robust),
        "integrator": write_integrator(problem),
        "solver": asdict(problem.solver),
    }


def problem_to_toml(problem: ProblemData) -> str:
    """Return a problem file that loads as the same problem, see `tables_of`: a result keeps it."""
    return to_toml(tables_of(problem))


def _write_free(robot: Robot, path: Sequence[BoundedTerm]) -> tuple[dict[str, Any] | None, list[BoundedTerm]]:
    """The table of a ground whose contacts are found, or None, and the other path constraints."""
    feet = [one for one in path if isinstance(one, FreeContactBounds)]
    forces = [one.force for one in feet]
    rest = [one for one in path if one not in feet and one not in forces]
    if not feet:
        return None, rest
    frames = {one.force.contact.constraint: robot.frame_names[one.term.frame] for one in feet}
    said, friction = feet[0].contact, forces[0].contact.friction
    words = {"contact": "free", "height": said.height, "smoothing": said.smoothing}
    return {"feet": frames, "friction": friction, **words}, rest


def _steps(problem: ProblemData) -> dict[str, Any]:
    """What says which steps there are."""
    if problem.accuracy is not None:
        return {"accuracy": problem.accuracy}
    return {"steps": problem.num_steps} if problem.lengths is None else {"lengths": problem.lengths}


def write_tables(problem: ProblemData) -> dict[str, Any]:
    """Tables of a problem as they are read from its file: without what is None, and without empty tables."""
    return {name: table for name, table in _without_none(plain(tables_of(problem))).items() if table != {}}


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(entry) for key, entry in value.items() if entry is not None}
    return [_without_none(entry) for entry in value] if isinstance(value, list) else value


def to_toml(document: Mapping[str, Any]) -> str:
    """Return `document` as TOML: plain keys first, then one `[table]` after the other; None is left out."""
    plain = [(key, value) for key, value in document.items() if not isinstance(value, Mapping)]
    lines = [f"{toml_key(key)} = {_value(value)}" for key, value in plain if value is not None]
    for name, table in document.items():
        if isinstance(table, Mapping) and table:
            lines += ["", f"[{toml_key(name)}]"]
            lines += [
                f"{toml_key(key)} = {_value(value)}" for key, value in table.items() if value is not None
            ]
    return "\n".join(lines).lstrip("\n") + "\n"


def toml_key(name: str) -> str:
    """Return a key as TOML has it, in quotes where it needs them."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def _value(value: Any) -> str:
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, Mapping):
        return (
            "{" + ", ".join(f"{toml_key(k)} = {_value(v)}" for k, v in value.items() if v is not None) + "}"
        )
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_value(entry) for entry in value) + "]"
    return json.dumps(str(value), ensure_ascii=False)
