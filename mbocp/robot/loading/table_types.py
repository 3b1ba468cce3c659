"""Numbers, vectors, placements and the base of the tables of a robot.toml."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    PositiveFloat,
    model_validator,
)

from mbocp._measured import Measured
from mbocp._numbers import finite_number, is_number
from mbocp._text import has_control_characters, show

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


def vector_of(expected: str, *counts: int) -> Callable[[Any], tuple[float, ...]]:
    """Make a validator of so many finite numbers; `expected` says them in messages."""

    def read(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list | tuple) or len(value) not in counts or not all(map(is_number, value)):
            raise ValueError(f"got {show(value)}, expected {expected}")
        return tuple(map(finite_number, value))

    return read


def _has_length(numbers: tuple[float, ...]) -> tuple[float, ...]:
    if len(numbers) == 4 and np.linalg.norm(numbers) < _MIN_NORM:
        raise ValueError(f"got {show(list(numbers))}, expected a quaternion that is not zero")
    return numbers


_TURN = "a quaternion x, y, z, w, or roll, pitch, yaw [rad]"
Position: TypeAlias = Annotated[Any, BeforeValidator(vector_of("3 numbers [m]", 3)), Measured("m")]
Orientation: TypeAlias = Annotated[
    Any, AfterValidator(_has_length), BeforeValidator(vector_of(_TURN, 3, 4)), Measured("rad")
]
