"""What tables of a solved problem say of its path constraints, row by row."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbocp._numbers import is_number
from mbocp.terms.span import SPAN, AtVia, End, Place, Share, Span

if TYPE_CHECKING:
    from mbocp.terms import FrameGoal

__all__ = ["PathRow", "are_pairs", "rows_of_path", "rows_of_term", "rows_of_via"]


class PathRow(NamedTuple):
    """What a row of the path constraints says.

    Attributes
    ----------
    lower, upper : float
        Bounds; the same where it is an equation.
    unit : str
    span : Span
        When it holds.
    """

    lower: float
    upper: float
    unit: str
    span: Span

    @property
    def is_equation(self) -> bool:
        """Whether both bounds are the same."""
        return self.lower == self.upper


def rows_of_path(table: Mapping[str, Any], nodes: Mapping[str, Place]) -> dict[str, PathRow]:
    """What each row of a table `[[path]]` says, by its name.

    Parameters
    ----------
    table : mapping
    nodes : mapping of str to (int, int)
        First and last ones of via points and phases, by name.
    """
    from mbocp.terms import PATH_TERMS  # slow to import, and wanted only where there is a path

    kind = PATH_TERMS.get(str(table.get("kind")))
    name, unit = str(table.get("name", "")), "" if kind is None else kind.unit
    pairs = {f"{name}.{axis}": table[axis] for axis in "xyz" if are_pairs([table.get(axis)])}
    ends = [table.get("min", -np.inf), table.get("max", np.inf)]
    pairs |= {name: ends} if not pairs and are_pairs([ends]) else {}
    pairs |= _kept(name, table.get("tolerance"))
    pairs |= _followed(name, table) if table.get("kind") == "follow" else {}
    sides = {row: (float(lower), float(upper)) for row, (lower, upper) in pairs.items()}
    return {row: PathRow(*bounds, unit, _span_of(table, nodes)) for row, bounds in sides.items()}


def rows_of_term(table: Mapping[str, Any], nodes: Mapping[str, Place]) -> dict[str, PathRow]:
    """The same of a path constraint of one's own, a table `[[terms]]`."""
    name, rows = str(table.get("name", "")), _rows_of(table)
    labels = [name] if len(rows) == 1 else [f"{name}.{i}" for i in range(len(rows))]
    unit, span = str(table.get("unit", "")), _span_of(table, nodes)
    return {label: PathRow(*bounds, unit, span) for label, bounds in zip(labels, rows, strict=True)}


def rows_of_via(name: str, goals: Iterable[FrameGoal]) -> dict[str, PathRow]:
    """Boxes and cones of a via point; under its name and a colon what holds of all others, equations."""
    found = {f"{name}: ": PathRow(0.0, 0.0, "", Span())}
    for goal in goals:
        if goal.position_tolerance is not None:
            for i in goal.target.coordinates:
                side = float(goal.position_tolerance[i])
                found[f"{name}: {'xyz'[i]} of {goal.name}"] = PathRow(-side, side, "m", Span())
        if goal.orientation_tolerance is not None:
            cone = PathRow(-np.inf, goal.orientation_tolerance, "rad", Span())
            found[f"{name}: angle of {goal.name}"] = cone
    return found


def _kept(name: str, tolerance: Any) -> dict[str, list[float]]:
    """Rows of a constraint that has a tolerance; equations where it is zero."""
    if not is_number(tolerance):
        return {}
    return (
        {f"{name}.{axis}": [0.0, 0.0] for axis in "xyz"} if tolerance == 0 else {name: [-np.inf, tolerance]}
    )


def _followed(name: str, table: Mapping[str, Any]) -> dict[str, list[float]]:
    """Rows of a path beside the distance from it."""
    found = {f"{name}.along": [0.0, 0.0], f"{name}.end": [0.0, 0.0]}
    angle = table.get("orientation_tolerance")
    if is_number(angle) and angle > 0:
        return {**found, f"{name}.turn": [-np.inf, angle]}
    return found | {f"{name}.turn_{axis}": [0.0, 0.0] for axis in "xyz"}


def _span_of(table: Mapping[str, Any], nodes: Mapping[str, Place]) -> Span:
    """When a path constraint holds; ends that are odd are left out."""
    ends = (_end_of(table.get(key)) for key in SPAN)
    known = (None if isinstance(end, AtVia) and end.name not in nodes else end for end in ends)
    return Span(*known).at_via(nodes, "")


def _end_of(written: Any) -> End:
    if isinstance(written, str):
        return AtVia(written)
    if isinstance(written, dict):
        if isinstance(written.get("phase"), str):
            part = written.get("share")
            return AtVia(written["phase"], share=float(part)) if is_number(part) and 0 <= part <= 1 else None
        share = written.get("share")
        return Share(float(share)) if is_number(share) else None
    return float(written) if is_number(written) else None


def _rows_of(table: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Bounds of a path constraint of one's own."""
    lower, upper = table.get("lower"), table.get("upper")
    if not (isinstance(lower, list) and isinstance(upper, list) and len(lower) == len(upper)):
        return []
    pairs = [[low, high] for low, high in zip(lower, upper, strict=True)]
    return [(float(low), float(high)) for low, high in pairs] if are_pairs(pairs) else []


def are_pairs(rows: Any) -> bool:
    """Whether it is a list of pairs of numbers."""
    return isinstance(rows, list) and all(
        isinstance(row, list) and len(row) == 2 and all(isinstance(number, (int, float)) for number in row)
        for row in rows
    )
