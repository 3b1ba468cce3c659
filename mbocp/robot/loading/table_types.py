"""The tables of a robot.toml: kinds of values, names of one model, and refusals that say where."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, TypeAlias, TypeVar

import numpy as np
import pinocchio as pin
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

from mbocp._arrays import Array, dataclass, plain
from mbocp._keys import Kind
from mbocp._measured import KeyUnits
from mbocp._quantities import finite_number, is_number
from mbocp._text import find_repeated, has_control_characters, show
from mbocp.exceptions import InvalidValue, RobotError, RobotFileError, suggest
from mbocp.robot import joints, kinematics
from mbocp.robot.loading.locking import refuse_follower
from mbocp.robot.parts import Connector

_MAX_VALUE = 1e15  # of numbers in the equations, as in files of robots
_MIN_NORM = 1e-8  # below, the direction of a quaternion is noise
_MIN_DIRECTION = 1e-15  # largest component of a direction
Number: TypeAlias = Annotated[FiniteFloat, Field(ge=-_MAX_VALUE, le=_MAX_VALUE)]
PositiveNumber: TypeAlias = Annotated[PositiveFloat, Field(le=_MAX_VALUE)]
Metres: TypeAlias = Annotated[PositiveNumber, KeyUnits("m")]
Vector3: TypeAlias = tuple[Number, Number, Number]
Numbers: TypeAlias = Number | list[Number]
Length: TypeAlias = Annotated[FiniteFloat, Field(ge=0, le=_MAX_VALUE)]
Place: TypeAlias = Annotated[Vector3, KeyUnits("m")]
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


class FrozenTable(BaseModel):
    """A table that takes no other keys than its own, and does not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


class PairTable(FrozenTable):
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
Position: TypeAlias = Annotated[Any, vector_of("3 numbers [m]", 3), KeyUnits("m")]
Orientation: TypeAlias = Annotated[Any, AfterValidator(_has_length), vector_of(_TURN, 3, 4), KeyUnits("rad")]


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


@dataclass(frozen=True)
class TableReader:
    """Names of joints and frames as indices of one model.

    Parameters
    ----------
    model : pin.Model
        After locking.
    locked : tuple of str
        Names of the joints that were locked.
    robot : str
        Name for messages.
    file : Path
        Where the tables stand, for messages.
    q0 : ndarray, shape (nq,)
        Initial pose; lengths that are not given are measured there.
    """

    model: pin.Model
    locked: tuple[str, ...]
    robot: str
    file: Path
    q0: Array

    def joint(self, name: str) -> int:
        """Index of a joint that moves by itself. Raises `UnknownJoint`; refuses mimic joints."""
        joint = joints.joint_id(self.model, name, self.robot)
        refuse_follower(self.model, joint, self.robot)
        return joint

    def frame(self, name: str) -> int:
        """Index of a frame by name. Raises `UnknownFrame`."""
        return kinematics.frame_id(self.model, name, self.robot)

    def read_moving_frame(self, name: str, key: str, consequence: str = "") -> int:
        """Index of a frame that is not fixed to the world; `key` and `consequence` are for the message."""
        frame = self.frame(name)
        if self.model.frames[frame].parentJoint == 0:
            self.refuse(key, f"frame {name!r} is fixed to the world{consequence}")
        return frame

    def pair(self, names: tuple[str, str], where: str) -> tuple[int, int]:
        """Indices of two frames by name, which must be on bodies that move against each other."""
        a, b = (self.frame(name) for name in names)
        if self.model.frames[a].parentJoint == self.model.frames[b].parentJoint:
            self.refuse(where, f"frames {names[0]!r} and {names[1]!r} are on the same rigid body")
        return a, b

    def distance(self, a: int, b: int) -> float:
        """Distance of the origins of two frames at the initial pose [m]."""
        pair = Connector(a, b, "line")
        return float(np.linalg.norm(kinematics.distances(self.model, self.q0, [pair])[0]))

    def refuse_repetition(self, what: str, names: Sequence[str]) -> None:
        """Refuse a name that several elements have."""
        if repeated := find_repeated(names):
            self.refuse(what, f"the name {repeated[0]!r} is given twice")

    def refuse(self, key: str, reason: str) -> NoReturn:
        """Raise the error for a key of the file."""
        raise RobotFileError(self.file, reason, key)
