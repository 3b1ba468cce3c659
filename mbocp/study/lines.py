"""What the lines of a study's file hold: whether they are a header and rows, before anybody relies on it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    StrictBool,
    StrictInt,
    StrictStr,
    ValidationError,
)

MAX_TASKS = 10**9  # of a study
_MAX_COUNT = 2**53  # of anything that is counted: beyond it, numbers of other programs are not exact

_Count = Annotated[StrictInt, Field(ge=0, le=_MAX_COUNT)]
_Number = FiniteFloat | None


class _Header(BaseModel):
    model_config = ConfigDict(extra="allow")

    name: StrictStr = ""
    digest: StrictStr = ""
    tasks: Annotated[StrictInt, Field(ge=0, le=MAX_TASKS)] = 0
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
