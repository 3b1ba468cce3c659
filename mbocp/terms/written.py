"""Kinds of values of a problem file: numbers, vectors, tables of numbers by name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field
from pydantic.json_schema import SkipJsonSchema

from mbocp._keys import Key, Kind, Table, Takes
from mbocp._quantities import as_float, check_named_numbers, finite_number, is_number, vector
from mbocp._text import show

Vector: TypeAlias = list[float]
Named: TypeAlias = dict[str, float | list[float]]


def read_vector(value: Any) -> Vector | Named:
    """A list of numbers, or a table of them by name."""
    if isinstance(value, list):
        return vector(value)
    if isinstance(value, Mapping):
        return check_named_numbers(value)
    raise ValueError(f"got {show(value)}, expected a list of numbers or a table by joint name")


def range_of(value: Any, where: str = "") -> list[float]:
    """A pair [lower, upper]; infinite where there is no bound."""
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"got {show(value)}{where}, expected [lower, upper]")
    return [read_side(side, where) for side in value]


def read_side(value: Any, where: str = "") -> float:
    """One side of a bound."""
    if not is_number(value) or math.isnan(value):
        raise ValueError(f"got {show(value)}{where}, expected a number (inf for no limit)")
    return as_float(value)


def _trajectory_or_vector(value: Any) -> list[Vector] | Vector | Named:
    if isinstance(value, list) and value and all(isinstance(row, list) for row in value):
        return [vector(row, f" of row {n}") for n, row in enumerate(value)]
    return read_vector(value)


def _vector_or_number(value: Any) -> float | Vector:
    return vector(value) if isinstance(value, list) else finite_number(value)


def _control(value: Any) -> float | Vector | Named:
    if isinstance(value, (list, Mapping)):
        return read_vector(value)
    return finite_number(value)


def _control_or_auto(value: Any) -> float | Vector | Named | str:
    return AUTO if value == AUTO else _control(value)


def _triple_or_zero(value: Any) -> Any:
    """Three numbers; 0 means that all are zero."""
    return [0.0, 0.0, 0.0] if is_number(value) and value == 0 else value


def _control_or_free(value: Any) -> float | Vector | Named | str:
    return FREE if value == FREE else _control(value)


AUTO = "auto"  # what is written where mbocp is to choose
FREE = "free"  # what is written where nothing is asked for
Finite = Annotated[float, Kind("number", finite_number, float)]
Positive = Annotated[Finite, Takes("number > 0", {"exclusiveMinimum": 0})]
NonNegative = Annotated[Finite, Takes("number >= 0", {"minimum": 0})]
Bound = Annotated[Any, Kind("number", read_side, float)]
Range = Annotated[Any, Kind("pair", range_of, Vector)]
Pair = Annotated[list[Finite] | None, Field(min_length=2, max_length=2), Takes("2 numbers")]
Triple = Annotated[list[Finite] | None, Field(min_length=3, max_length=3), Takes("3 numbers")]
Quaternion = Annotated[list[Finite] | None, Field(min_length=4, max_length=4), Takes("4 numbers")]
TripleOrZero = Annotated[Triple, Kind("3 numbers, or 0 for rest", _triple_or_zero, Literal[0])]
VectorOrNamed = Annotated[Any, Kind("vector", read_vector, Vector | Named)]
VectorOrNumber = Annotated[Any, Kind("number, or list", _vector_or_number, float | Vector)]
Control = Annotated[Any, Kind("number, vector", _control, float | Vector | Named)]
ControlWeights = Annotated[Control, Takes("number >= 0, list, table")]
ControlOrFree = Annotated[
    Any, Kind(f'number, vector, or `"{FREE}"`', _control_or_free, float | Vector | Named | Literal["free"])
]
ControlOrAuto = Annotated[
    Any, Kind(f'number, vector, `"{AUTO}"`', _control_or_auto, float | Vector | Named | Literal["auto"])
]
Trajectory = Annotated[
    Any, Kind("vector, or a list of them", _trajectory_or_vector, Vector | Named | list[Vector])
]


class TargetTable(Table):
    """What the running cost tracks."""

    q: Annotated[Trajectory, Key("of the goal, or one for every step", "m, rad", "the goal's")] = None
    p: Annotated[
        Trajectory, Key("of the goal, or one for every step", "kg m/s, N m s", "that of the goal")
    ] = None


class WeightsTable(Table):
    """Diagonal weights on (q, p): one list, or `q` and `p` apart."""

    qp: Annotated[VectorOrNamed, SkipJsonSchema()] = None  # where a plain list lands
    q: Annotated[Control, Key("weights on q", default="0")] = None
    p: Annotated[Control, Key("on p, or on v where the goal gives v", default="0")] = None


def _expand_weights(value: Any) -> Any:
    return {"qp": value} if isinstance(value, list) else value


Weights = Annotated[WeightsTable, Kind("2 nv numbers, or table with `q` and `p`", _expand_weights, Vector)]
