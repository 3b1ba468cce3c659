"""Schema of robot.toml, which adds to a URDF; docs/robots.md explains each key."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from pydantic import BaseModel, Field, FiniteFloat, ValidationError, model_validator

from mbocp._files import read_toml
from mbocp.exceptions import RobotError, RobotFileError, Unreadable
from mbocp.robot.loading.actuator_tables import (
    ActuationTable,
    Actuator,
    DriveTable,
    JointActuator,
    Thruster,
    Wrench,
)
from mbocp.robot.loading.force_tables import QuarticSpringTable, SpringDamperTable
from mbocp.robot.loading.part_table import PartTable
from mbocp.robot.loading.payload_table import PayloadTable
from mbocp.robot.loading.schema_errors import first_complaint
from mbocp.robot.loading.table_types import (
    FramePair,
    Number,
    Numbers,
    PositiveNumber,
    Printable,
    Table,
    Vector3,
)
from mbocp.robot.loops.constraints import CONSTRAINTS, ConstraintKeys

if TYPE_CHECKING:
    ConstraintTable: TypeAlias = ConstraintKeys
else:
    _KINDS = reduce(or_, (kind.Keys for kind in CONSTRAINTS.values()))
    ConstraintTable = Annotated[_KINDS, Field(discriminator="type")]


class InitialTable(Table):
    """[initial]: the initial pose, as the whole configuration or by joint."""

    q: list[Number] | dict[str, Numbers]


class VisualTable(Table):
    """Something to draw between two frames."""

    type: Literal["rod", "spring", "line", "none"]
    frames: FramePair
    radius: PositiveNumber | None = None
    color: list[Annotated[FiniteFloat, Field(ge=0, le=1)]] | None = Field(
        default=None, min_length=3, max_length=4
    )


class CollisionSphereTable(Table):
    """A sphere that stands for a part of a link where it may collide."""

    frame: str
    center: Vector3 = (0.0, 0.0, 0.0)
    radius: PositiveNumber


# Keys that say how a URDF is read; a file that assembles parts has none.
_OF_FILES = (
    "urdf",
    "package_dirs",
    "free_flyer",
    "mimic",
    "damping",
    "friction",
    "friction_speed",
    "spherical",
)


class RobotTable(Table):
    """The whole file."""

    name: Printable | None = None
    description: Printable = ""
    urdf: str = "robot.urdf"
    package_dirs: list[str] = Field(default=[])
    free_flyer: bool | None = None
    gravity: Vector3 | None = None
    lock: list[str] | dict[str, Numbers] = Field(default=[])
    mimic: bool | None = None
    damping: bool | None = None
    friction: Literal["none", "smooth"] | None = None
    friction_speed: PositiveNumber | None = None
    spherical: list[str] = Field(default=[])
    rotations: Literal["quaternion", "dcm"] | None = None
    trace: list[str] | None = None
    actuation: ActuationTable = ActuationTable.model_construct()
    actuators: list[Actuator] = Field(default=[], alias="actuator")
    drives: list[DriveTable] = Field(default=[], alias="drive")
    constraints: list[ConstraintTable] = Field(default=[], alias="constraint")
    springs: list[QuarticSpringTable] = Field(default=[], alias="spring")
    spring_dampers: list[SpringDamperTable] = Field(default=[], alias="spring_damper")
    payloads: list[PayloadTable] = Field(default=[], alias="payload")
    initial: InitialTable | None = None
    visuals: list[VisualTable] = Field(default=[], alias="visual")
    collision_spheres: list[CollisionSphereTable] = Field(default=[], alias="collision_sphere")
    parts: list[PartTable] = Field(default=[], alias="part")

    @model_validator(mode="after")
    def _parts_have_files(self) -> RobotTable:
        for key in _OF_FILES if self.parts else ():
            if key in self.model_fields_set:
                raise ValueError(f"{key}: does not go with part; write it into each part")
        return self


def tables_from(data: Mapping[str, Any]) -> RobotTable:
    """Validate tables of a robot.toml that stand elsewhere.

    Raises
    ------
    RobotError
        Naming key, what was got and what is allowed.
    """
    try:
        return RobotTable.model_validate(dict(data))
    except ValidationError as error:
        key, reason = first_complaint(error, data, _allowed_keys)
        raise RobotError(f"{key}: {reason}") from error


def read_robot_toml(path: Path) -> RobotTable:
    """Read and validate a robot.toml.

    Raises
    ------
    RobotFileError
        Naming file, key, what was got and what is allowed.
    """
    try:
        data = read_toml(path, expected="a robot.toml")
    except Unreadable as error:
        raise RobotFileError(path, error.reason) from error
    try:
        return RobotTable.model_validate(data)
    except ValidationError as error:
        key, reason = first_complaint(error, data, _allowed_keys)
        raise RobotFileError(path, reason, key) from error


TABLES: dict[str, tuple[type[BaseModel], ...]] = {
    "actuation": (ActuationTable,),
    "actuator": (JointActuator, Wrench, Thruster),
    "drive": (DriveTable,),
    "constraint": tuple(kind.Keys for kind in CONSTRAINTS.values()),
    "spring": (QuarticSpringTable,),
    "spring_damper": (SpringDamperTable,),
    "payload": (PayloadTable,),
    "initial": (InitialTable,),
    "visual": (VisualTable,),
    "collision_sphere": (CollisionSphereTable,),
    "part": (PartTable,),
}


def _allowed_keys(loc: tuple[int | str, ...]) -> list[str]:
    """Keys of the table that an unknown key stands in."""
    if len(loc) == 1:
        return [field.alias or name for name, field in RobotTable.model_fields.items()]
    candidates = TABLES[str(loc[0])]
    tagged = [c for c in candidates if any(step in _tags(c) for step in loc[1:])]
    return [name for table in (tagged or candidates)[:1] for name in table.model_fields]


def _tags(table: type[BaseModel]) -> tuple[str, ...]:
    field = table.model_fields.get("type")
    return tuple(getattr(field.annotation, "__args__", ())) if field is not None else ()
