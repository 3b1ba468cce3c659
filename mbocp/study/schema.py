"""The study file as pydantic models: which keys there are and what kind of value each takes.

The tables that go by problem keys (`fixed`, `grid`, `sample`, ...) are only known to be tables here;
`mbocp.study.values` looks at what is in them.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, TypeAlias

from pydantic import BaseModel, BeforeValidator, ConfigDict

from mbocp._numbers import as_float, is_number
from mbocp._text import show

Keys: TypeAlias = dict[str, Any]
Entries: TypeAlias = list[dict[str, Any]]
Names: TypeAlias = list[str]


def _positive(value: Any) -> float:
    if not is_number(value) or not 0.0 < as_float(value) < math.inf:
        raise ValueError(f"got {show(value)}, expected a number above 0")
    return as_float(value)


def _problem(value: Any) -> str | dict[str, Any]:
    if not isinstance(value, (str, dict)):
        raise ValueError(f"got {show(value)}, expected the path of a problem file, or its tables")
    return value


def _seed(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"got {show(value)}, expected a whole number, 0 or above")
    return value


Positive = Annotated[float, BeforeValidator(_positive)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class AxisTable(_Table):
    """An axis of named values, each a table of problem keys and a `label`."""

    name: str
    values: Entries


class SummaryTable(_Table):
    """How the rows are summed up; it changes nothing about the runs."""

    by: Names | None = None
    goal_distance: Positive | None = None


Axes: TypeAlias = list[AxisTable]


class StudyTable(_Table):
    """A whole study file."""

    problem: Annotated[Any, BeforeValidator(_problem)]
    name: str | None = None
    seed: Annotated[int, BeforeValidator(_seed)] = 0
    time_limit: Positive | None = None
    record: Names = []
    fixed: Keys = {}
    grid: Keys = {}
    axis: Axes = []
    sample: Keys | None = None
    list: Entries = []  # noqa: A003, RUF100
    summary: SummaryTable = SummaryTable()
