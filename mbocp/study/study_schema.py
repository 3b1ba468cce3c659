"""The study file as pydantic models, and the lines that it comes to: what kind of value each key takes.

The tables that go by problem keys (`fixed`, `grid`, `sample`, ...) are only known to be tables here;
`mbocp.study.values` looks at what is in them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, TypeAlias

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    StrictBool,
    StrictInt,
    StrictStr,
    ValidationError,
)

from mbocp._measured import KeyUnits
from mbocp._quantities import as_float, is_number
from mbocp._text import show

Keys: TypeAlias = dict[str, Any]
Entries: TypeAlias = list[dict[str, Any]]
Names: TypeAlias = list[str]

_MAX_TASKS = 10**9  # of a study
_MAX_COUNT = 2**53  # of anything that is counted: beyond it, numbers of other programs are not exact


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
    time_limit: Annotated[Positive, KeyUnits("s")] | None = None
    record: Names = []
    fixed: Keys = {}
    grid: Keys = {}
    axis: Axes = []
    sample: Keys | None = None
    list: Entries = []  # noqa: A003, RUF100
    summary: SummaryTable = SummaryTable()


_Count = Annotated[StrictInt, Field(ge=0, le=_MAX_COUNT)]
_Number = FiniteFloat | None


class _Header(BaseModel):
    model_config = ConfigDict(extra="allow")

    name: StrictStr = ""
    digest: StrictStr = ""
    tasks: Annotated[StrictInt, Field(ge=0, le=_MAX_TASKS)] = 0
    varied: list[StrictStr] = []
    by: list[StrictStr] = []
    record: list[StrictStr] = []
    goal_distance: _Number = None
    tables: dict[str, Any] = {}


class _Row(BaseModel):
    """All but the index may be missing: an earlier mbocp wrote less."""

    model_config = ConfigDict(extra="allow")

    index: _Count
    values: dict[str, Any] = {}
    status: StrictStr = ""
    converged: StrictBool = False
    iterations: _Count | None = None
    solver_time_s: _Number = None
    total_time_s: _Number = None
    cost: _Number = None
    residual: _Number = None
    constraint_violation: _Number = None
    manifold_drift: _Number = None
    limit_violation: _Number = None
    goal_distance: _Number = None
    message: StrictStr | None = None
    record: dict[str, Any] = {}


def is_header(line: Mapping[str, Any]) -> bool:
    """Whether it says what a study is."""
    return _fits(_Header, line)


def is_row(line: Mapping[str, Any]) -> bool:
    """Whether it says what came of a task."""
    return _fits(_Row, line)


def _fits(model: type[BaseModel], line: Mapping[str, Any]) -> bool:
    try:
        model.model_validate(line)
    except ValidationError:
        return False
    return True
