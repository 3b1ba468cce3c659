"""Several results side by side: their numbers, and the keys of their problems that differ."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from mbocp._files import parse_toml
from mbocp._text import show
from mbocp.exceptions import Unreadable
from mbocp.solution import Solution

_LONGEST = 160  # text of a value
_NUMBERS: Mapping[str, tuple[Callable[[Solution], float], str]] = {
    "cost": (lambda solution: solution.cost, ".7g"),
    "duration [s]": (lambda solution: solution.duration, ".5g"),
    "steps": (lambda solution: solution.num_steps, "d"),
    "iterations": (lambda solution: solution.iterations, "d"),
    "time of the solve [s]": (lambda solution: solution.wall_time_s, ".3g"),
    "residual": (lambda solution: solution.residual, ".3g"),
    "violation of constraints": (lambda solution: solution.constraint_violation, ".3g"),
    "violation of limits": (lambda solution: solution.limit_violation, ".3g"),
    "excess between nodes [%]": (lambda solution: 100.0 * solution.limit_excess, ".3g"),
    "clearance [m]": (lambda solution: solution.clearance, ".4g"),
    "work of the controls [J]": (lambda solution: solution.positive_work, ".4g"),
    "largest error of a step": (lambda solution: solution.accuracy.local_error, ".2g"),
}


def numbers_of(results: Mapping[str, Solution]) -> list[list[str]]:
    """Rows of a table: a name, and a cell for each result; numbers that none has are left out."""
    rows = [["status", *(str(solution.status) for solution in results.values())]]
    for name, (number, written) in _NUMBERS.items():
        values = [number(solution) for solution in results.values()]
        if np.isfinite(values).any():
            rows.append([name, *(format(x, written) if np.isfinite(x) else "-" for x in values)])
    return rows


def differences_of(results: Mapping[str, Solution]) -> list[list[str]]:
    """Rows of a table: a key of the problem files, and what each result has for it, where that differs."""
    keys = [dict(_keys_of(solution)) for solution in results.values()]
    return [
        [name, *(show(each[name], _LONGEST) if name in each else "-" for each in keys)]
        for name in dict.fromkeys(name for each in keys for name in each)
        if any(each.get(name) != keys[0].get(name) for each in keys)
    ]


def _keys_of(solution: Solution) -> Iterator[tuple[str, Any]]:
    try:
        document = parse_toml(solution.problem_text)
    except Unreadable:  # of results that another program wrote
        return
    tables: list[tuple[str, Any]] = [("", document)]
    for prefix, table in tables:
        for key, value in table.items():
            if isinstance(value, dict):
                tables.append((f"{prefix}{key}.", value))
            else:
                yield f"{prefix}{key}", value
