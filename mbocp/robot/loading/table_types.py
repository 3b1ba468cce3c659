"""Numbers, vectors, placements and the base of the tables of a robot.toml, and what pydantic says of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    PositiveFloat,
    ValidationError,
    model_validator,
)

from mbocp._arrays import plain
from mbocp._keys import Kind
from mbocp._measured import Measured
from mbocp._numbers import finite_number, is_number
from mbocp._text import has_control_characters, show
from mbocp.exceptions import InvalidValue, RobotError, suggest

_MAX_VALUE = 1e15  # of numbers in the equations, as in files of robots
_MIN_NORM = 1e-8  # below, the direction of a quaternion is noise
_MIN_DIRECTION = 1e-15  # largest component of a direction
Number: TypeAlias = Annotated[FiniteFloat, Field(ge=-_MAX_VALUE, le=_MAX_VALUE)]
PositiveNumber: TypeAlias = Annotated[PositiveFloat, Field(le=_MAX_VALUE)]
Metres: TypeAlias = Annotated[PositiveNumber, Measured("m")]
Vector3: TypeAlias = tuple[Number, Number, Number]
Numbers: TypeAlias = Number | list[Number]
Length: TypeAlias = Annotated[FiniteFloat, Field(ge=0, le=_MAX_VALUE)]
Place: TypeAlias = Annotated[Vector3, Measured("m")]
Component: TypeAlias = Literal["fx", "fy", "fz", "mx", "my", "mz"]
FramePair: TypeAlias = tuple[str, str]
_Model = TypeVar("_Model", bound=BaseModel)
Allowed: TypeAlias = Callable[[tuple[int | str, ...]], list[str]]  # keys of the table that one stands in


def _printable(text: str) -> str:
    if has_control_characters(text.replace("\n", " ").replace("\t", " ")):
        raise ValueError("must not have control characters")
    return text


Printable: TypeAlias = Annotated[str, AfterValidator(_printable)]


def is_zero(vector: tuple[float, float, float]) -> bool:
    """Whether a vector has no direction in double precision."""
    return max(map(abs, vector)) < _MIN_DIRECTION


def _has_direction(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if is_zero(vector):
        raise ValueError("must not be zero")
    return vector


Direction: TypeAlias = Annotated[Vector3, AfterValidator(_has_direction)]


class Table(BaseModel):
    """A table that takes no other keys than its own, and does not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


class PairTable(Table):
    """What acts between two frames."""

    name: str | None = None
    frames: FramePair

    @model_validator(mode="after")
    def _two_frames(self) -> PairTable:
        if self.frames[0] == self.frames[1]:
            raise ValueError(f"frames must be two different frames, got {self.frames[0]!r} twice")
        return self


def vector_of(expected: str, *counts: int) -> Kind:
    """Return the kind of so many finite numbers; `expected` says them in messages."""

    def read(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list | tuple) or len(value) not in counts or not all(map(is_number, value)):
            raise ValueError(f"got {show(value)}, expected {expected}")
        return tuple(map(finite_number, value))

    return Kind(expected, read, Annotated[list[float], Field(min_length=min(counts), max_length=max(counts))])


def _has_length(numbers: tuple[float, ...]) -> tuple[float, ...]:
    if len(numbers) == 4 and np.linalg.norm(numbers) < _MIN_NORM:
        raise ValueError(f"got {show(list(numbers))}, expected a quaternion that is not zero")
    return numbers


_TURN = "a quaternion x, y, z, w, or roll, pitch, yaw [rad]"
Position: TypeAlias = Annotated[Any, vector_of("3 numbers [m]", 3), Measured("m")]
Orientation: TypeAlias = Annotated[Any, AfterValidator(_has_length), vector_of(_TURN, 3, 4), Measured("rad")]


def first_complaint(error: ValidationError, data: Any, allowed: Allowed) -> tuple[str, str]:
    """Key and words of the first complaint."""
    first = error.errors()[0]
    more = f" ({error.error_count() - 1} more)" if error.error_count() > 1 else ""
    return _key(data, first["loc"], absent=first["type"] == "missing"), _reason(first, allowed) + more


def refusal(error: ValidationError, where: str, data: Any, allowed: Allowed) -> RobotError:
    """Make the error for a table that stands in no file of its own; `where` names it."""
    key, reason = first_complaint(error, data, allowed)
    return RobotError(f"{'.'.join(word for word in (where, key) if word)}: {reason}")


def read_table(model: type[_Model], value: Any, where: str) -> _Model:
    """Read a table that Python gives; `where` names it.

    Raises
    ------
    RobotError
        For an unknown or missing key or a wrong value, naming it.
    """
    data = plain(value)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise refusal(error, where, data, lambda _: list(model.model_fields)) from error


def _key(data: Any, loc: tuple[int | str, ...], *, absent: bool) -> str:
    """Dotted key as in the file, e.g. constraint[0].frames, without pydantic's tags for unions."""
    parts: list[str] = []
    node, last = data, len(loc) - 1
    for position, step in enumerate(loc):
        if isinstance(step, int):
            parts.append(f"[{step}]")
        elif (absent and position == last) or _has(node, step, is_last=position == last):
            parts.append(f".{step}")
        else:
            continue
        node = _child(node, step)
    return "".join(parts).lstrip(".")


def _has(node: Any, step: str, *, is_last: bool) -> bool:
    """Whether a step leads on: a tag may have the name of a key, which holds no more steps."""
    return isinstance(node, dict) and step in node and (is_last or isinstance(node[step], dict | list))


def _child(node: Any, step: int | str) -> Any:
    if isinstance(node, dict):
        return node.get(step)
    return node[step] if isinstance(node, list) and isinstance(step, int) and step < len(node) else None


def _reason(error: Any, allowed: Allowed) -> str:
    kind, context, got = error["type"], error.get("ctx", {}), error["input"]
    if kind == "extra_forbidden":
        return f"unknown key; {suggest(str(error['loc'][-1]), allowed(error['loc']))}"
    if kind == "missing":
        return "this key is required" if isinstance(error["loc"][-1], str) else "this number is missing"
    if kind == "union_tag_not_found":
        return f"type is required: {_plain(context.get('discriminator', 'type'))}"
    if kind == "union_tag_invalid":
        return f"unknown type {show(context['tag'])}, known: {_plain(context['expected_tags'])}"
    if kind == "literal_error":
        return f"got {show(got)}, expected {InvalidValue.of_literal(error).expected}"
    if kind == "model_type":
        return f"got {show(got)}, expected a table"
    message = error["msg"].removeprefix("Value error, ")
    return message if kind == "value_error" else f"got {show(got)}: {message}"


def _plain(text: str) -> str:
    return text.replace("'", "").replace(" or ", ", ")
