"""Path constraints as people write them: `[[path]]` with frames by name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbocp.exceptions import ProblemError
from mbocp.problem._checks import check_choice
from mbocp.problem.file.messages import located
from mbocp.problem.path import PATH_KINDS, PathConstraint
from mbocp.robot import Robot

if TYPE_CHECKING:
    from mbocp.problem.file.schema import PathTable

__all__ = ["path_from", "path_tables"]

# What each kind takes beside name, kind and frame.
_KEYS = {"position": ("x", "y", "z"), "distance": ("frame_b", "point", "min", "max"), "speed": ("max",)}


def path_from(robot: Robot, tables: list[PathTable]) -> tuple[PathConstraint, ...]:
    """Make the constraints from the tables of `[[path]]`.

    Raises
    ------
    ProblemError, UnknownFrame, InvalidValue
        If a frame is unknown, or keys do not fit the kind.
    """
    found = []
    for i, table in enumerate(tables):
        with located(f"path.{i}"):
            found.append(_constraint(robot, table, f"path.{i}"))
    return tuple(found)


def path_tables(robot: Robot, path: tuple[PathConstraint, ...]) -> list[dict[str, Any]]:
    """Return the tables that read back as `path`."""
    return [_table(robot, constraint) for constraint in path]


def _constraint(robot: Robot, table: PathTable, key: str) -> PathConstraint:
    kind = check_choice(f"{key}.kind", table.kind, PATH_KINDS)
    given = {name: getattr(table, name) for name in ("x", "y", "z", "frame_b", "point", "min", "max")}
    given = {name: value for name, value in given.items() if value is not None}
    for name in given:
        if name not in _KEYS[kind]:
            raise ProblemError(f'{key}.{name}: kind = "{kind}" does not use it, but {", ".join(_KEYS[kind])}')
    if kind == "position":
        axes = tuple(i for i, axis in enumerate("xyz") if axis in given)
        if not axes:
            raise ProblemError(f"{key}: bounds nothing; give x, y or z as [lower, upper]")
        lower, upper = np.array([given["xyz"[i]] for i in axes]).T
    else:
        if "min" not in given and "max" not in given:
            raise ProblemError(f"{key}: bounds nothing; give {'max' if kind == 'speed' else 'min or max'}")
        if kind == "distance" and ("frame_b" in given) == ("point" in given):
            raise ProblemError(f"{key}: a distance is between two things; give frame_b or point")
        axes, lower, upper = (), [given.get("min", -np.inf)], [given.get("max", np.inf)]
    other = given.get("frame_b")
    return PathConstraint(
        name=table.name or f"{kind} of {table.frame}",
        kind=kind,  # type: ignore[arg-type]  # checked above
        frame=robot.frame_id(table.frame),
        other=None if other is None else robot.frame_id(other),
        point=given.get("point", np.zeros(3)),
        axes=axes,
        lower=lower,
        upper=upper,
    )


def _table(robot: Robot, constraint: PathConstraint) -> dict[str, Any]:
    table: dict[str, Any] = {"name": constraint.name, "kind": constraint.kind}
    table["frame"] = robot.frame_names[constraint.frame]
    if constraint.kind == "position":
        sides = zip(constraint.axes, constraint.lower, constraint.upper, strict=True)
        return table | {"xyz"[i]: [low, high] for i, low, high in sides}
    if constraint.other is not None:
        table["frame_b"] = robot.frame_names[constraint.other]
    elif constraint.kind == "distance":
        table["point"] = constraint.point
    for key, value in (("min", constraint.lower[0]), ("max", constraint.upper[0])):
        if np.isfinite(value):
            table[key] = value
    return table
