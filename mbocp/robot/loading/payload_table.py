"""`[[payload]]` of a robot.toml, `[[robot.payload]]` of a problem file: what a robot carries."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, TypeAlias

from pydantic import BaseModel, BeforeValidator, ConfigDict, model_validator

from mbocp._measured import Measured
from mbocp._numbers import finite_number
from mbocp._text import has_control_characters, show
from mbocp.exceptions import InvalidValue, RobotError, suggest
from mbocp.robot.loading.schema_errors import read_table
from mbocp.robot.loading.table_types import Orientation, Position, vector_of
from mbocp.robot.payload import INERTIA_KEYS, SHAPES, Payload

_INERTIA = f"3 numbers ixx, iyy, izz, 6 numbers {', '.join(INERTIA_KEYS)}, or a table of these"


def _inertia(value: Any) -> tuple[float, ...]:
    if isinstance(value, Mapping):
        for key in value:
            if key not in INERTIA_KEYS:
                raise ValueError(f"unknown key {show(key)}; {suggest(str(key), INERTIA_KEYS)}")
        missing = [key for key in INERTIA_KEYS[:3] if key not in value]
        if missing:
            raise ValueError(f"{missing[0]} is missing; give ixx, iyy, izz and what is not zero of the rest")
        value = [value.get(key, 0.0) for key in INERTIA_KEYS]
    if isinstance(value, list | tuple) and len(value) == 3:
        value = [*value, 0.0, 0.0, 0.0]
    return vector_of(_INERTIA, 6)(value)


def _name(value: Any) -> str:
    if not isinstance(value, str) or not value or has_control_characters(value):
        raise ValueError(f"got {show(value)}, expected a name")
    return value


Inertia: TypeAlias = Annotated[Any, BeforeValidator(_inertia), Measured("kg m^2")]
Mass: TypeAlias = Annotated[float, BeforeValidator(finite_number), Measured("kg")]
Name: TypeAlias = Annotated[str, BeforeValidator(_name)]


def check_body(**said: Any) -> None:
    """Refuse numbers that no body has, as pydantic wants it."""
    try:
        Payload(**said)
    except InvalidValue as error:
        key = error.name.rpartition(": ")[2]
        raise ValueError(f"{key}: got {error.got}, expected {error.expected}") from error


class ShapeTable(BaseModel):
    """Mass and shape of a body."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)

    mass: Mass | None = None
    com: Position = (0.0, 0.0, 0.0)
    inertia: Inertia = (0.0,) * 6
    box: Annotated[Any, BeforeValidator(vector_of("3 lengths x, y, z [m]", 3)), Measured("m")] = None
    sphere: Annotated[Any, BeforeValidator(finite_number), Measured("m")] = None
    cylinder: Annotated[Any, BeforeValidator(vector_of("radius and length [m]", 2)), Measured("m")] = None


class PayloadTable(ShapeTable):
    """A body that the robot carries, rigidly attached to one of its frames, see `Payload`."""

    name: Name | None = None
    frame: Name
    mass: Mass
    position: Position | None = None
    orientation: Orientation | None = None

    @model_validator(mode="after")
    def _is_a_body(self) -> PayloadTable:
        check_body(**{"name": "payload", **self.model_dump(exclude_none=True)})
        return self

    def payload(self, default: str) -> Payload:
        """The payload; `default` is its name if none is given."""
        said = self.model_dump(exclude_none=True)
        return Payload(**{"name": default, **said})


def payloads_of(given: Iterable[Payload | PayloadTable | Mapping[str, Any]]) -> tuple[Payload, ...]:
    """Payloads from tables; those without a name are payload_0, payload_1, ... by their place.

    Raises
    ------
    RobotError
        For an unknown or missing key or a wrong value, naming it.
    """
    return tuple(_payload(entry, number) for number, entry in enumerate(given))


def _payload(entry: Any, number: int) -> Payload:
    if isinstance(entry, Payload):
        return entry
    where = f"payload[{number}]"
    if isinstance(entry, PayloadTable):
        return entry.payload(f"payload_{number}")
    if not isinstance(entry, Mapping):
        keys = ", ".join(("frame", "mass", *SHAPES))
        raise RobotError(f"{where}: got {show(entry)}, expected a table with {keys}")
    said = {key: value for key, value in entry.items() if value is not None}
    return read_table(PayloadTable, said, where).payload(f"payload_{number}")
