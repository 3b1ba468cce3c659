"""Rows of a study summed up: how often, how fast and how well, for each group of tasks."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from mbocp._arrays import dataclass, plain_json

MISSED = "off the goal"  # converged, but further from the goal than a success may be


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation (of a sample) of some numbers; NaN where there are too few."""

    mean: float
    deviation: float

    @classmethod
    def of(cls, values: Sequence[float | None]) -> Spread:
        """Of those that are numbers."""
        numbers = np.array([value for value in values if value is not None], dtype=np.float64)
        if not numbers.size:
            return cls(math.nan, math.nan)
        with np.errstate(over="ignore", invalid="ignore"):  # infinite where squares have no number
            deviation = float(numbers.std(ddof=1)) if numbers.size > 1 else math.nan
            return cls(float(numbers.mean()), deviation)

    def to_dict(self) -> dict[str, float | None]:
        """As plain values, for JSON."""
        return plain_json(asdict(self))


@dataclass(frozen=True)
class TaskGroup:
    """Tasks that share the values of what the summary goes by.

    Attributes
    ----------
    values : tuple
        One for each name in `Summary.by`.
    tasks, successes : int
        How many there are, and how many of them converged (and reached the goal, if that is asked for).
    iterations, seconds, seconds_per_iteration, cost : Spread
        Over the successes; times are the solver's, without compilation, guess and diagnostics [s].
    others : mapping
        How the rest ended, and how many.
    best : int or None
        Index of the success with the least cost.
    """

    values: tuple[Any, ...]
    tasks: int
    successes: int
    iterations: Spread
    seconds: Spread
    seconds_per_iteration: Spread
    cost: Spread
    others: Mapping[str, int]
    best: int | None

    @property
    def success_rate(self) -> float:
        """Part of the tasks that are successes."""
        return self.successes / self.tasks

    @property
    def label(self) -> str:
        """The values in words."""
        return ", ".join(word(value) for value in self.values) or "all tasks"

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for JSON."""
        found: dict[str, Any] = plain_json(asdict(self))
        return {**found, "success_rate": self.success_rate}


@dataclass(frozen=True)
class Summary:
    """Groups of tasks, in the order in which their values first occur.

    Attributes
    ----------
    by : tuple of str
        What tells the groups apart.
    groups : tuple of TaskGroup
    goal_distance : float or None
        How far from the goal a success may end; None: as far as it likes.
    """

    by: tuple[str, ...]
    groups: tuple[TaskGroup, ...]
    goal_distance: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for JSON."""
        groups = [group.to_dict() for group in self.groups]
        return {"by": list(self.by), "goal_distance": self.goal_distance, "groups": groups}


def summarise(
    rows: Sequence[Mapping[str, Any]], by: Sequence[str] = (), goal_distance: float | None = None
) -> Summary:
    """Sum up rows, in groups of the same values of `by`."""
    ranks: list[dict[str, int]] = [{} for _ in by]  # of each value, by its first row
    members: dict[tuple[int, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        values = (repr(row.get("values", {}).get(name)) for name in by)
        place = tuple(rank.setdefault(value, len(rank)) for rank, value in zip(ranks, values, strict=True))
        members.setdefault(place, []).append(row)
    groups = tuple(_group(members[place], by, goal_distance) for place in sorted(members))
    return Summary(tuple(by), groups, goal_distance)


def word(value: Any) -> str:
    """Return a value as it is written in tables and pictures."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return f"{value:.6g}"
    if isinstance(value, list):
        return f"[{', '.join(map(word, value))}]"
    return "-" if value is None else str(value)


def _group(rows: Sequence[Mapping[str, Any]], by: Sequence[str], goal_distance: float | None) -> TaskGroup:
    ends = [_end(row, goal_distance) for row in rows]
    good = [row for row, end in zip(rows, ends, strict=True) if not end]
    costs = {row["index"]: row["cost"] for row in good if row.get("cost") is not None}
    return TaskGroup(
        values=tuple(rows[0].get("values", {}).get(name) for name in by),
        tasks=len(rows),
        successes=len(good),
        iterations=Spread.of([row.get("iterations") for row in good]),
        seconds=Spread.of([row.get("solver_time_s") for row in good]),
        seconds_per_iteration=Spread.of([_per_iteration(row) for row in good]),
        cost=Spread.of([row.get("cost") for row in good]),
        others=dict(Counter(end for end in ends if end).most_common()),
        best=min(costs, key=costs.__getitem__, default=None),
    )


def _end(row: Mapping[str, Any], goal_distance: float | None) -> str:
    """Return why a task is no success; "" if it is one."""
    if not row.get("converged", False):
        return str(row.get("status", ""))
    distance = row.get("goal_distance")
    return MISSED if goal_distance is not None and distance is not None and distance > goal_distance else ""


def _per_iteration(row: Mapping[str, Any]) -> float | None:
    seconds, iterations = row.get("solver_time_s"), row.get("iterations")
    return seconds / iterations if seconds is not None and iterations else None
