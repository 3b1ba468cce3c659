"""`[[robot.part]]` of a problem file, `[[part]]` of a robot.toml: what stands in a world beside others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Annotated, Any

import pinocchio as pin
from pydantic import BeforeValidator, Field, ValidationError, model_validator

from mbocp._numbers import finite_number
from mbocp._text import has_control_characters, shown
from mbocp.exceptions import InvalidValue, RobotError, suggest
from mbocp.robot.kinematics import WORLD
from mbocp.robot.loading.object_urdf import solid_inertia
from mbocp.robot.loading.payload_table import PayloadTable, ShapeTable
from mbocp.robot.loading.placement_table import Orientation, Position, placement_from
from mbocp.robot.payload import SHAPES, Payload
from mbocp.robot.placed import SEPARATOR


def _name(value: Any) -> str:
    if not isinstance(value, str) or not value or SEPARATOR in value or has_control_characters(value):
        raise ValueError(f"got {shown(value)}, expected a name without {SEPARATOR!r}")
    if value == WORLD:
        raise ValueError(f"got {shown(value)}, which is the frame that stands still; take another name")
    return value


def _lock(value: Any) -> Any:
    if isinstance(value, list | tuple) and all(isinstance(name, str) for name in value):
        return list(value)
    if isinstance(value, Mapping):
        return {name: _angles(entry) for name, entry in value.items()}
    raise ValueError(f"got {shown(value)}, expected joint names or a table with a position for each")


def _angles(value: Any) -> Any:
    return [finite_number(v) for v in value] if isinstance(value, list | tuple) else finite_number(value)


_OF_OBJECTS = ("mass", "com", "inertia", *SHAPES)
_OF_ROBOTS = ("lock", "actuated", "mimic", "damping", "friction", "friction_speed", "package_dirs")


class PartTable(ShapeTable):
    """A robot or a simple body, the frame that its base is fixed to, and options of `load_robot` for it."""

    robot: str | None = None
    name: Annotated[str, BeforeValidator(_name)]
    parent: str = WORLD
    position: Position = (0.0, 0.0, 0.0)
    orientation: Orientation = (0.0, 0.0, 0.0, 1.0)
    free_flyer: bool | None = None
    lock: Annotated[Any, BeforeValidator(_lock)] = None
    actuated: list[str] | None = None
    mimic: bool | None = None
    damping: bool | None = None
    friction: str | None = None
    friction_speed: float | None = None
    package_dirs: list[str] = Field(default=[])
    payload: list[PayloadTable] | None = None

    @model_validator(mode="after")
    def _a_robot_or_an_object(self) -> PartTable:
        told = self._told(_OF_OBJECTS)
        if self.robot is not None:
            if told:
                raise ValueError(f"{told[0]}: does not go with robot; it makes a part a body of its own")
            return self
        if not told:
            raise ValueError(
                f"robot is missing: name or path; or give mass and {', '.join(SHAPES)} of a simple body"
            )
        for key in self._told(_OF_ROBOTS):
            raise ValueError(f"{key}: is a matter of robots; a simple body has no joints of its own")
        self._check_object()
        return self

    def _told(self, keys: Iterable[str]) -> list[str]:
        """Keys with another value than the default."""
        fields = type(self).model_fields
        return [key for key in keys if getattr(self, key) != fields[key].default]

    def _check_object(self) -> None:
        floats = self.free_flyer is not False
        if floats and not self.mass:
            raise ValueError("mass: a body that floats needs one above 0; or say free_flyer = false")
        try:
            shape = self.shape
        except InvalidValue as error:
            key = error.name.rpartition(": ")[2]
            raise ValueError(f"{key}: got {error.got}, expected {error.expected}") from error
        if floats and not any(shape.inertia):
            raise ValueError(f"inertia: a body that floats needs one: give {', '.join(SHAPES)} or inertia")

    @property
    def is_object(self) -> bool:
        """Whether the part is a body of given mass and shape, and no robot from a file."""
        return self.robot is None

    @property
    def shape(self) -> Payload:
        """Mass, inertia and shape of an object; the inertia of the filled shape if none is given."""
        said = self.model_dump(include=set(_OF_OBJECTS), exclude_none=True)
        shape = Payload(**{"name": self.name, "frame": self.name, "mass": 0.0, **said})
        return shape if any(shape.inertia) else replace(shape, inertia=solid_inertia(shape))

    @property
    def placement(self) -> pin.SE3:
        """Of the base in the parent frame."""
        return placement_from(self.position, self.orientation)


def part_of(entry: PartTable | Mapping[str, Any], number: int) -> PartTable:
    """A part from a table.

    Raises
    ------
    RobotError
        For an unknown or missing key or a wrong value, naming it.
    """
    if isinstance(entry, PartTable):
        return entry
    try:
        return PartTable.model_validate(entry)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join([f"part[{number}]", *(str(step) for step in first["loc"])])
        if first["type"] == "extra_forbidden":
            words = f"unknown key; {suggest(str(first['loc'][-1]), PartTable.model_fields)}"
        elif first["type"] == "missing":
            words = "this key is required"
        elif first["type"] == "value_error":
            words = str(first["ctx"]["error"])
        else:
            words = f"got {shown(first['input'])}: {first['msg']}"
        raise RobotError(f"{key}: {words}") from error
