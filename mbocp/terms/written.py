"""How keys of a problem file are written: the kind of value each takes, and what the documentation says."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias, TypeVar, get_type_hints

from pydantic import BaseModel, BeforeValidator, ConfigDict, create_model

from mbocp._numbers import as_float, finite_number, is_number, named_numbers, vector
from mbocp._text import shown
from mbocp.exceptions import InvalidValue

Vector: TypeAlias = list[float]
Named: TypeAlias = dict[str, float | list[float]]


class Table(BaseModel):
    """A table of a problem file: keys that it does not have are refused."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, defer_build=True)


T = TypeVar("T", bound=Table)


def check_weight_is_given(table: Any, weight: str, keys: tuple[str, ...]) -> None:
    """Refuse keys of a term of the cost that does not count, since nobody gave its weight.

    Raises
    ------
    InvalidValue
        Naming the first of the keys that is given.
    """
    given = table.model_fields_set
    said = [] if weight in given else [key for key in keys if key in given and _says_something(table, key)]
    if said:
        expected = f"cost.{weight}, the weight of the term that it belongs to"
        raise InvalidValue(f"cost.{said[0]}", f"no cost.{weight}", expected)


def _says_something(table: Any, key: str) -> bool:
    """Whether a key is neither None nor a table without keys."""
    value = getattr(table, key)
    return value is not None and bool(getattr(value, "model_fields_set", True))


@dataclass(frozen=True)
class Key:
    """What the documentation says of a key, beside its name.

    Attributes
    ----------
    takes, unit, default, says : str
        Columns of the table of keys.
    beside : tuple of str
        Keys that the same line describes.
    """

    takes: str
    unit: str
    default: str
    says: str
    beside: tuple[str, ...] = ()


def merged(name: str, words: str, parts: Iterable[type[Table]], base: type[T]) -> type[T]:
    """`base` with the keys of all `parts`, in their order; one that several have is theirs in common."""
    fields: dict[str, Any] = {}
    for part in parts:
        hints = get_type_hints(part, include_extras=True)
        for key, field in part.model_fields.items():
            fields.setdefault(key, (hints[key], ... if field.is_required() else field.default))
    return create_model(name, __base__=base, __doc__=words, __module__=__name__, **fields)


def vector_or_named(value: Any) -> Vector | Named:
    """A list of numbers, or a table of them by name."""
    if isinstance(value, list):
        return vector(value)
    if isinstance(value, Mapping):
        return named_numbers(value)
    raise ValueError(f"got {shown(value)}, expected a list of numbers or a table by joint name")


def range_of(value: Any, where: str = "") -> list[float]:
    """A pair [lower, upper]; infinite where there is no bound."""
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"got {shown(value)}{where}, expected [lower, upper]")
    return [sided(side, where) for side in value]


def sided(value: Any, where: str = "") -> float:
    """One side of a bound."""
    if not is_number(value) or math.isnan(value):
        raise ValueError(f"got {shown(value)}{where}, expected a number (inf for no limit)")
    return as_float(value)


def _trajectory_or_vector(value: Any) -> list[Vector] | Vector | Named:
    if isinstance(value, list) and value and all(isinstance(row, list) for row in value):
        return [vector(row, f" of row {n}") for n, row in enumerate(value)]
    return vector_or_named(value)


def _vector_or_number(value: Any) -> float | Vector:
    return vector(value) if isinstance(value, list) else finite_number(value)


def _control(value: Any) -> float | Vector | Named:
    if isinstance(value, (list, Mapping)):
        return vector_or_named(value)
    return finite_number(value)


def _control_or_auto(value: Any) -> float | Vector | Named | str:
    return AUTO if value == AUTO else _control(value)


AUTO = "auto"  # what is written where mbocp is to choose
VectorOrNamed = Annotated[Any, BeforeValidator(vector_or_named)]
ControlOrAuto = Annotated[Any, BeforeValidator(_control_or_auto)]
Trajectory = Annotated[Any, BeforeValidator(_trajectory_or_vector)]
Control = Annotated[Any, BeforeValidator(_control)]
Finite = Annotated[float, BeforeValidator(finite_number)]
Range = Annotated[Any, BeforeValidator(range_of)]
VectorOrNumber = Annotated[Any, BeforeValidator(_vector_or_number)]
Bound = Annotated[Any, BeforeValidator(sided)]
