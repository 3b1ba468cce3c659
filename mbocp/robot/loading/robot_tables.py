"""Tables of a robot.toml and of `[robot]`: payloads, elastic joints, masses and inertias of links."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, TypeAlias, TypeVar

from pydantic import BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from mbocp._keys import Key, KeyGroup, Kind
from mbocp._keys import Table as KeyTable
from mbocp._measured import KeyUnits
from mbocp._quantities import finite_number
from mbocp._text import has_control_characters, show
from mbocp.exceptions import InvalidValue, RobotError, suggest
from mbocp.robot.loading.table_types import (
    FrozenTable,
    Orientation,
    Position,
    first_complaint,
    read_table,
    vector_of,
)
from mbocp.robot.payload import INERTIA_KEYS, MAX_VALUE, SHAPES, Payload

_INERTIA = f"3 numbers ixx, iyy, izz, 6 numbers {', '.join(INERTIA_KEYS)}, or a table of these"
_SUFFIX = "_motor"

Positive = Annotated[float, Kind("number > 0", finite_number, float), Field(gt=0, le=MAX_VALUE)]
_NotNegative = Annotated[float, Kind("number >= 0", finite_number, float), Field(ge=0, le=MAX_VALUE)]


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
    found: tuple[float, ...] = vector_of(_INERTIA, 6).read(value)
    return found


def _name(value: Any) -> str:
    if not isinstance(value, str) or not value or has_control_characters(value):
        raise ValueError(f"got {show(value)}, expected a name")
    return value


Inertia: TypeAlias = Annotated[
    Any, Kind(_INERTIA, _inertia, list[float] | dict[str, float]), KeyUnits("kg m^2")
]
Mass: TypeAlias = Annotated[float, BeforeValidator(finite_number), KeyUnits("kg")]
Name: TypeAlias = Annotated[str, BeforeValidator(_name)]


def check_body(**said: Any) -> None:
    """Refuse numbers that no body has, as pydantic wants it."""
    try:
        Payload(**said)
    except InvalidValue as error:
        key = error.name.rpartition(": ")[2]
        raise ValueError(f"{key}: got {error.got}, expected {error.expected}") from error


class ShapeTable(KeyGroup):
    """Mass and shape of a body."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)

    mass: Annotated[
        Mass | None, Key("of a [simple body](robots.md#objects)", "kg", "required, or `robot`", "number")
    ] = None
    com: Annotated[Position, Key("centre of mass", "m", "0", "3 numbers")] = (0.0, 0.0, 0.0)
    inertia: Annotated[
        Inertia,
        Key(
            "about it, in the frame's axes: ixx, iyy, izz, ixy, ixz, iyz",
            "kg m^2",
            "a point mass, of a part its filled shape",
            "3 or 6 numbers, or a table",
        ),
    ] = (0.0,) * 6
    box: Annotated[
        Any,
        vector_of("3 lengths x, y, z [m]", 3),
        Key(
            "about `com`; a cylinder along z",
            "m",
            takes="3 lengths; radius; radius and length",
            beside=("sphere", "cylinder"),
        ),
    ] = None
    sphere: Annotated[Any, Kind("number", finite_number, float)] = None
    cylinder: Annotated[Any, vector_of("radius and length [m]", 2)] = None


class PayloadTable(ShapeTable):
    """A body that the robot carries, rigidly attached to one of its frames, see `Payload`."""

    name: Annotated[
        Name | None, Key("of the body and its frame", default="`payload_0`, ...", takes="string")
    ] = None
    frame: Annotated[Name, Key("that carries it")]
    mass: Annotated[Mass, Key("of a tool or a load", "kg")]
    position: Annotated[
        Position | None, Key("of its tip, the origin of its frame", "m", "the centre of mass", "3 numbers")
    ] = None
    orientation: Annotated[
        Orientation | None,
        Key(
            "of its frame: roll, pitch, yaw, or a quaternion x, y, z, w",
            "rad",
            "those of `frame`",
            "3 or 4 numbers",
        ),
    ] = None

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


class ElasticTable(KeyTable):
    """A joint between which and its motor there are a spring and a damper."""

    joint: Annotated[str, Key("a revolute or prismatic joint")]
    stiffness: Annotated[Positive, Key("of the spring between joint and motor", "N m/rad, N/m")]
    damping: Annotated[_NotNegative, Key("of the damper beside it", "N m s/rad, N s/m")] = 0.0
    motor_inertia: Annotated[Positive, Key("of the rotor, behind the gear", "kg m^2, kg")]


class MotorTable(KeyTable):
    """A motor that turns a joint by a gear; its control is the torque before the gear."""

    joint: Annotated[str, Key("a joint that turns, and has a motor")]
    gear_ratio: Annotated[Positive, Key("turns of the motor for one of the joint")] = 1.0
    inertia: Annotated[
        _NotNegative | None, Key("of the rotor, before the gear", "kg m^2", "that of its files")
    ] = None
    effort: Annotated[
        Positive | None, Key("largest torque of the motor", "N m", "the joint's by gear_ratio")
    ] = None
    speed: Annotated[
        Positive | None, Key("largest speed of the motor", "rad/s", "the joint's times gear_ratio")
    ] = None


T = TypeVar("T", ElasticTable, MotorTable)


def read_rows(kind: type[T], key: str, rows: Sequence[T | Mapping[str, Any]] | None) -> list[T] | None:
    """Read the tables that Python gives.

    Raises
    ------
    RobotError
        For an unknown or missing key or a wrong value, naming it.
    """
    if rows is None:
        return None
    return [read_table(kind, row, f"{key}[{number}]") for number, row in enumerate(rows)]


def motor_of(joint: str) -> str:
    """Name of the joint of an elastic joint's motor."""
    return joint + _SUFFIX


class LinkTable(FrozenTable):
    """Mass of a link, and its centre of mass and inertia; those of its shapes where they are missing."""

    mass: Annotated[Positive, KeyUnits("kg")]
    com: Position | None = None
    inertia: Inertia | None = None

    @model_validator(mode="after")
    def _is_a_body(self) -> LinkTable:
        check_body(frame="", **self.model_dump(exclude_none=True))
        return self

    @property
    def is_whole(self) -> bool:
        """Whether it says all."""
        return self.com is not None and self.inertia is not None


def _links(value: Any) -> dict[str, LinkTable]:
    if not isinstance(value, Mapping):
        raise ValueError(f"got {show(value)}, expected a table for each link")
    return {link: _link(link, table) for link, table in value.items()}


def _link(link: str, table: Any) -> LinkTable:
    if isinstance(table, LinkTable):
        return table
    try:
        return LinkTable.model_validate(table)
    except ValidationError as error:
        key, reason = first_complaint(error, table, lambda _: list(LinkTable.model_fields))
        raise ValueError(f"{link}{key and '.'}{key}: {reason}") from error


class InertiasTable(KeyTable):
    """Where masses and inertias of links come from that the file does not give."""

    density: Annotated[
        Positive | None, Key("of [links without inertias](robots.md#robots-without-inertias)", "kg/m^3")
    ] = None
    mass: Annotated[Positive | None, Key("of the whole robot, from which the density follows", "kg")] = None
    links: Annotated[
        Any,
        Kind("table", _links, dict[str, dict[str, Any]]),
        Key("`mass`, `com`, `inertia` by link, in place of what the file says", "kg, m, kg m^2"),
    ] = Field(default={})

    @model_validator(mode="after")
    def _says_one_of_them(self) -> InertiasTable:
        if self.density is not None and self.mass is not None:
            raise ValueError("give either density [kg/m^3] or mass [kg], of the whole robot")
        if self.density is None and self.mass is None and not self.links:
            raise ValueError("give density [kg/m^3], mass [kg] of the whole robot, or links")
        return self

    @property
    def is_whole(self) -> bool:
        """Whether it has numbers alone, and no shape is needed."""
        return self.density is self.mass is None and all(link.is_whole for link in self.links.values())

    def within(self, prefix: str) -> InertiasTable:
        """Those links whose names begin so, without the prefix."""
        links = {
            name.removeprefix(prefix): link for name, link in self.links.items() if name.startswith(prefix)
        }
        return self.model_copy(update={"links": links})


def read_inertias(value: InertiasTable | Mapping[str, Any] | None) -> InertiasTable | None:
    """Read the table that Python gives.

    Raises
    ------
    RobotError
        For an unknown or missing key or a wrong value, naming it.
    """
    if value is None:
        return None
    if not isinstance(value, InertiasTable | Mapping):
        raise RobotError(f"inertias: got {show(value)}, expected a table with density, mass or links")
    return read_table(InertiasTable, value, "inertias")
