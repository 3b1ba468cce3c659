"""`[[robot.part]]` of a problem file: a robot that is placed in a world beside others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from mbocp._numbers import finite_number, is_number
from mbocp._text import has_control_characters, shown
from mbocp.exceptions import RobotError, suggest
from mbocp.robot.kinematics import WORLD
from mbocp.robot.loading.payload_table import PayloadTable
from mbocp.robot.placed import SEPARATOR

__all__ = ["PartTable", "part_of"]

_MIN_NORM = 1e-8  # below, the direction of a quaternion is noise


def _vector(value: Any, counts: tuple[int, ...], expected: str) -> tuple[float, ...]:
    if not isinstance(value, list | tuple) or len(value) not in counts or not all(map(is_number, value)):
        raise ValueError(f"got {shown(value)}, expected {expected}")
    return tuple(finite_number(entry) for entry in value)


def _position(value: Any) -> tuple[float, ...]:
    return _vector(value, (3,), "3 numbers [m]")


def _orientation(value: Any) -> tuple[float, ...]:
    numbers = _vector(value, (3, 4), "a quaternion x, y, z, w, or roll, pitch, yaw [rad]")
    if len(numbers) == 4 and np.linalg.norm(numbers) < _MIN_NORM:
        raise ValueError(f"got {shown(value)}, expected a quaternion that is not zero")
    return numbers


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


class PartTable(BaseModel):
    """A robot, the frame that its base is fixed to, and options of `load_robot` for it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    robot: str
    name: Annotated[str, BeforeValidator(_name)]
    parent: str = WORLD
    position: Annotated[Any, BeforeValidator(_position)] = (0.0, 0.0, 0.0)
    orientation: Annotated[Any, BeforeValidator(_orientation)] = (0.0, 0.0, 0.0, 1.0)
    free_flyer: bool | None = None
    lock: Annotated[Any, BeforeValidator(_lock)] = None
    actuated: list[str] | None = None
    mimic: bool | None = None
    damping: bool | None = None
    friction: str | None = None
    friction_speed: float | None = None
    package_dirs: list[str] = []
    payload: list[PayloadTable] | None = None

    @property
    def placement(self) -> pin.SE3:
        """Of the base in the parent frame."""
        if len(self.orientation) == 3:
            rotation = pin.rpy.rpyToMatrix(np.array(self.orientation))
        else:
            rotation = pin.Quaternion(np.array(self.orientation)).normalized().matrix()
        return pin.SE3(rotation, np.array(self.position))


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
