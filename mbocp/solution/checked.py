"""What the content of a result file must be before it becomes a solution.

The digest says that a file is as it was written; here is what mbocp writes: kinds and ranges of all values,
names for all columns, times that grow, and finite numbers wherever the status says that a solve converged.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar, get_type_hints

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, create_model

from mbocp._arrays import Array
from mbocp._text import printable, show
from mbocp._tolerances import STAYS
from mbocp.exceptions import InvalidValue
from mbocp.solution.details import Accuracy, StartRecord
from mbocp.solution.problem_facts import Facts
from mbocp.solution.solution_data import COUNTS, NUMBERS, SIGNED, WORDS, SolutionData
from mbocp.solvers.records import IterationRecord, Phase, Status
from mbocp.storage.content import ITERATE, QUANTITIES, FileContent

_Record = TypeVar("_Record", Phase, IterationRecord, StartRecord, Accuracy)


class _Strict(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, defer_build=True)


def _not_negative(value: float) -> float:
    if value < 0.0:  # NaN is none: it says that nobody computed the number
        raise ValueError("a negative number")
    return value


_Count = Annotated[int, Field(ge=0, lt=2**63)]
_Size = Annotated[float, AfterValidator(_not_negative)]


_KINDS: dict[str, Any] = {
    **dict.fromkeys(WORDS, str),
    **dict.fromkeys(COUNTS, _Count),
    **dict.fromkeys(NUMBERS, _Size),
    **dict.fromkeys(SIGNED, float),
    "status": Annotated[Status, Field(strict=False)],
}
_Summary = create_model(  # type: ignore[call-overload]
    "_Summary",
    __base__=_Strict,
    **{
        f.name: (_KINDS[f.name], ... if f.default is dataclasses.MISSING else f.default)
        for f in dataclasses.fields(SolutionData)
        if f.name in _KINDS
    },
)


def _table_of(record: type) -> type[_Strict]:
    """Model of the table that a record is stored as."""
    hints = get_type_hints(record)
    fields: dict[str, Any] = {
        f.name: (_read_as(hints[f.name]), ... if f.default is dataclasses.MISSING else f.default)
        for f in dataclasses.fields(record)
    }
    return create_model(record.__name__, __base__=_Strict, **fields)


def _read_as(hint: Any) -> Any:
    """Kind of a stored value: a status is stored as its word."""
    return Annotated[Status, Field(strict=False)] if hint is Status else hint


_TABLES: dict[type, type[_Strict]] = {
    record: _table_of(record) for record in (Phase, IterationRecord, StartRecord, Accuracy)
}


class _Structures(_Strict):
    phases: list[dict[str, Any]]
    history: list[dict[str, Any]]
    starts: list[dict[str, Any]] = []  # of several guesses
    accuracy: list[dict[str, Any]] = []  # one, where somebody has looked
    facts: dict[str, Any] = {}  # not in older files
    robot_spec: dict[str, Any]
    options: dict[str, Any]
    versions: dict[str, str]


class _Texts(_Strict):
    problem_text: str
    iterate_meaning: str = ""


def check_content(content: FileContent) -> None:
    """Check everything but how the lengths of the arrays fit together, which is what `Solution` checks.

    Raises
    ------
    InvalidValue
        Naming the value, what it is and what it should be.
    """
    _validate(_Summary, "summary", content.summary)
    _validate(_Structures, "text", content.structures)
    _validate(_Texts, "text", content.texts)
    _check_columns(content)
    _check_numbers(content, Status(content.summary["status"]))


def read_records(kind: type[_Record], tables: list[Mapping[str, Any]]) -> tuple[_Record, ...]:
    """Records of the solver from the tables that they were stored as.

    Raises
    ------
    InvalidValue
        If one has another key or kind of value.
    """
    model = _TABLES[kind]
    for i, table in enumerate(tables):
        _validate(model, f"{kind.__name__} {i}", table)
    return tuple(kind(**{name: _clean(value) for name, value in table.items()}) for table in tables)


def read_facts(table: Mapping[str, Any] | None) -> Facts | None:
    """Facts of the problem from the table that they were stored as; None where a file has none.

    Raises
    ------
    InvalidValue
        If one is of another kind.
    """
    if table is None:
        return None
    try:
        return TypeAdapter(Facts).validate_json(json.dumps(_clean_all(table)), strict=True)
    except ValidationError as error:
        raise _refusal("facts", error) from error


def _clean_all(value: Any) -> Any:
    if isinstance(value, dict):
        return {_clean(key): _clean_all(part) for key, part in value.items()}
    return [_clean_all(part) for part in value] if isinstance(value, list) else _clean(value)


def _clean(value: Any) -> Any:
    return printable(value) if isinstance(value, str) else value


_Model = TypeVar("_Model", bound=_Strict)


def _validate(model: type[_Model], where: str, values: Mapping[str, Any]) -> _Model:
    try:
        return model.model_validate(dict(values))
    except ValidationError as error:
        raise _refusal(where, error) from error


def _refusal(where: str, error: ValidationError) -> InvalidValue:
    """The first thing that is wrong."""
    first = error.errors(include_url=False)[0]
    name = ".".join(str(step) for step in first["loc"])
    got = "nothing" if first["type"] == "missing" else show(first["input"])
    return InvalidValue(f"{where}: {name}", got, first["msg"])


_EVERY = {**QUANTITIES, **ITERATE}
_AXES = ("a vector", "a table", "a block")


def _check_columns(content: FileContent) -> None:
    for name, array in content.arrays.items():
        quantity = _EVERY[name]
        axes = len(quantity.axes)
        if array.ndim != axes:
            raise InvalidValue(name, f"shape {array.shape}", _AXES[axes - 1])
        width = 1 if quantity.has_one_column else array.shape[-1]
        if len(content.columns[name]) != width:
            raise InvalidValue(f"columns of {name}", len(content.columns[name]), f"{width} names")


# What may have no value, and then NaN in its place; and what may be infinite, because nothing limits it.
_UNKNOWN = [name for name, quantity in QUANTITIES.items() if quantity.absent is math.nan]
_SIDES = [name for name, quantity in QUANTITIES.items() if quantity.axes[0] == "side"]


def _check_numbers(content: FileContent, status: Status) -> None:
    _check_times(content.arrays["t"])
    for name in _SIDES:
        limits = content.arrays.get(name)
        if limits is not None and not (limits.shape[:1] == (2,) and (limits[0] <= limits[1]).all()):
            raise InvalidValue(name, "other numbers", "lower limits, and upper ones above them")
    if status.is_stationary:
        _check_impacts(content.arrays["t"], content.arrays["qs"])
        _check_finite(content, status)


def _check_times(t: Array) -> None:
    if not np.isfinite(t).all() or not (np.diff(t) >= 0.0).all():
        raise InvalidValue("t", "other numbers", "finite times, none earlier than the one before")


def _check_impacts(t: Array, qs: Array) -> None:
    """Refuse a solution that moves in no time: impacts leave the configuration."""
    leaps = np.diff(t) == 0.0
    if leaps.any() and not (len(qs) == len(t) and bool((np.abs(np.diff(qs, axis=0))[leaps] < STAYS).all())):
        raise InvalidValue("t", "other numbers", "times one later than the other, but for impacts")


def _check_finite(content: FileContent, status: Status) -> None:
    for name in ("cost", "residual"):
        if not np.isfinite(content.summary[name]):
            raise InvalidValue(name, content.summary[name], f"a finite number, for the status is {status}")
    for name, array in content.arrays.items():
        allowed = np.isfinite(array) | (np.isnan(array) if name in _UNKNOWN else name in _SIDES)
        if not allowed.all():
            where = tuple(int(i) for i in np.argwhere(~allowed)[0])
            got = f"{array[where]} at {list(where)}"
            raise InvalidValue(name, got, f"finite numbers, for the status is {status}")
