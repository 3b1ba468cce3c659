"""Schema of robot.toml, which adds to a model; docs/robot_toml.md has each key."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from pydantic import (
    AfterValidator,
    BaseModel,
    Field,
    FiniteFloat,
    PositiveFloat,
    ValidationError,
    model_validator,
)

from mbocp._files import read_toml
from mbocp._measured import KeyUnits
from mbocp._text import find_repeated
from mbocp.exceptions import RobotFileError
from mbocp.robot.loading.joint_numbers import FrictionModel
from mbocp.robot.loading.robot_keys import OF_FILES, PartTable
from mbocp.robot.loading.robot_tables import ElasticTable, InertiasTable, LinkTable, MotorTable, PayloadTable
from mbocp.robot.loading.table_types import (
    Component,
    Direction,
    FramePair,
    FrozenTable,
    Length,
    Metres,
    Number,
    Numbers,
    PairTable,
    Place,
    PositiveNumber,
    Printable,
    Vector3,
    first_complaint,
    refusal,
)
from mbocp.robot.loops.constraints import CONSTRAINTS
from mbocp.robot.loops.kinds.constraint import ConstraintKeys
from mbocp.robot.parts import Rotations

if TYPE_CHECKING:
    ConstraintTable: TypeAlias = ConstraintKeys
else:
    _KINDS = reduce(or_, (kind.Keys for kind in CONSTRAINTS.values()))
    ConstraintTable = Annotated[_KINDS, Field(discriminator="type")]


class ActuationTable(FrozenTable):
    """[actuation]: the joints that have motors, in the order of the controls."""

    joints: list[str] | None = None


Efforts: TypeAlias = PositiveFloat | tuple[FiniteFloat, FiniteFloat]  # the largest of both signs, or a range


def _check_order(effort: Efforts) -> Efforts:
    if isinstance(effort, tuple) and not effort[0] < effort[1]:
        raise ValueError(f"got {list(effort)}, expected [lower, upper] with lower < upper")
    return effort


class JointActuator(FrozenTable):
    """A motor on a joint: one control for each velocity component of the joint."""

    type: Literal["joint"]
    joint: str
    effort: Annotated[Efforts, KeyUnits("N, N m"), AfterValidator(_check_order)] | None = None


class Wrench(FrozenTable):
    """Forces and moments on a frame, in its own axes: one control a component."""

    type: Literal["wrench"]
    frame: str
    name: str | None = None
    components: list[Component] = Field(default=["fx", "fy", "fz", "mx", "my", "mz"], min_length=1)
    effort: Annotated[PositiveFloat | list[PositiveFloat], KeyUnits("N, N m")] | None = None

    @model_validator(mode="after")
    def _one_effort_a_component(self) -> Wrench:
        if len(set(self.components)) != len(self.components):
            raise ValueError(f"components are repeated: {', '.join(self.components)}")
        if isinstance(self.effort, list) and len(self.effort) != len(self.components):
            raise ValueError(f"effort has {len(self.effort)} numbers for {len(self.components)} components")
        return self


class Thruster(FrozenTable):
    """A thrust along an axis of a frame, with a reaction torque about it."""

    type: Literal["thruster"]
    frame: str
    name: str | None = None
    axis: Direction = (0.0, 0.0, 1.0)
    position: Place = (0.0, 0.0, 0.0)
    torque_ratio: Annotated[Number, KeyUnits("m")] = 0.0
    effort: Annotated[Efforts, KeyUnits("N"), AfterValidator(_check_order)] | None = None


class Tendon(FrozenTable):
    """A motor that pulls at several joints: each feels the control times its ratio."""

    type: Literal["tendon"]
    name: Printable
    joints: list[str] = Field(min_length=1)
    ratios: list[Number]
    effort: Annotated[Efforts, KeyUnits("N, N m"), AfterValidator(_check_order)] | None = None

    @model_validator(mode="after")
    def _one_ratio_a_joint(self) -> Tendon:
        if repeated := find_repeated(self.joints):
            raise ValueError(f"joints: {repeated[0]!r} is named twice")
        if len(self.ratios) != len(self.joints):
            raise ValueError(f"ratios has {len(self.ratios)} numbers for {len(self.joints)} joints")
        return self


class DriveTable(FrozenTable):
    """A control that prescribes a joint's motion, or a frame's along a direction."""

    name: str | None = None
    joint: str | None = None
    frame: str | None = None
    direction: Direction | None = None
    joints: Annotated[list[str], Field(min_length=1)] | None = None
    control: Literal["velocity", "acceleration"]
    limit: Annotated[PositiveFloat, KeyUnits("those of the number")] | None = None  # of the control

    @model_validator(mode="after")
    def _a_joint_or_a_frame(self) -> DriveTable:
        if (self.joint is None) == (self.frame is None):
            raise ValueError("give either joint, or frame with direction and joints")
        if self.joint is not None and (self.direction, self.joints) != (None, None):
            raise ValueError("direction and joints go with frame, not with joint")
        if self.frame is not None and (self.direction is None or self.joints is None):
            raise ValueError("frame needs direction (in its own axes) and joints (those that it is moved by)")
        return self


Actuator: TypeAlias = Annotated[JointActuator | Wrench | Thruster | Tendon, Field(discriminator="type")]


class QuarticSpringTable(PairTable):
    """A spring with a quartic potential."""

    type: Literal["quartic"] = "quartic"
    stiffness: Annotated[PositiveNumber, KeyUnits("N/m")] | None = None
    coefficient: Annotated[PositiveNumber, KeyUnits("N/m^3")] | None = None
    length: Metres | None = None

    @model_validator(mode="after")
    def _one_strength(self) -> QuarticSpringTable:
        if (self.stiffness is None) == (self.coefficient is None):
            raise ValueError("give either stiffness k [N/m] or coefficient c [N/m^3]; c = k/(2 length^2)")
        return self


class SpringDamperTable(PairTable):
    """A linear spring and damper."""

    stiffness: Annotated[Length, KeyUnits("N/m")] = 0.0
    damping: Annotated[Length, KeyUnits("N s/m")] = 0.0
    length: Annotated[Length, KeyUnits("m")] | None = None


class InitialTable(FrozenTable):
    """[initial]: the initial pose, as the whole configuration or by joint."""

    q: Annotated[list[Number] | dict[str, Numbers], KeyUnits("m, rad")]


class VisualTable(FrozenTable):
    """Something to draw between two frames."""

    type: Literal["rod", "spring", "line", "none"]
    frames: FramePair
    radius: Metres | None = None
    color: list[Annotated[FiniteFloat, Field(ge=0, le=1)]] | None = Field(
        default=None, min_length=3, max_length=4
    )


class CollisionSphereTable(FrozenTable):
    """A sphere that stands for a part of a link where it may collide."""

    frame: str
    center: Place = (0.0, 0.0, 0.0)
    radius: Metres


# Keys that say how a model is read; a file that assembles parts has none.
_OF_FILES = ("urdf", "package_dirs", *OF_FILES, "spherical")


def _name(rows: Any, kind: str) -> Any:
    """Call rows without a name by kind and place: weld_0, spring_1."""
    if not isinstance(rows, list):
        return rows
    return [
        {"name": f"{row.get('type') if kind == 'constraint' else kind}_{number}", **row}
        if isinstance(row, Mapping)
        else row
        for number, row in enumerate(rows)
    ]


_NAMED = ("constraint", "spring", "spring_damper")


class RobotTable(FrozenTable):
    """The whole file."""

    name: Printable | None = None
    description: Printable = ""
    urdf: str = "robot.urdf"
    package_dirs: list[str] = Field(default=[])
    free_flyer: bool | None = None
    gravity: Annotated[Vector3, KeyUnits("m/s^2")] | None = None
    lock: Annotated[list[str] | dict[str, Numbers], KeyUnits("m, rad")] = Field(default=[])
    mimic: bool | None = None
    dynamics: bool | None = None
    inertias: InertiasTable | None = None
    damping: bool | None = None
    friction: FrictionModel | None = None
    friction_speed: Annotated[PositiveNumber, KeyUnits("m/s, rad/s")] | None = None
    arguments: dict[str, str | bool | int | float] | None = None
    spherical: list[str] = Field(default=[])
    rotations: Rotations | None = None
    undriven: Literal["free", "hold"] = "free"
    trace: list[str] | None = None
    actuation: ActuationTable = ActuationTable.model_construct()
    actuators: list[Actuator] = Field(default=[], alias="actuator")
    drives: list[DriveTable] = Field(default=[], alias="drive")
    constraints: list[ConstraintTable] = Field(default=[], alias="constraint")
    elastic: list[ElasticTable] = Field(default=[])
    motor: list[MotorTable] = Field(default=[])
    springs: list[QuarticSpringTable] = Field(default=[], alias="spring")
    spring_dampers: list[SpringDamperTable] = Field(default=[], alias="spring_damper")
    payloads: list[PayloadTable] = Field(default=[], alias="payload")
    initial: InitialTable | None = None
    visuals: list[VisualTable] = Field(default=[], alias="visual")
    collision_spheres: list[CollisionSphereTable] = Field(default=[], alias="collision_sphere")
    parts: list[PartTable] = Field(default=[], alias="part")

    @model_validator(mode="before")
    @classmethod
    def _rows_have_names(cls, data: Any) -> Any:
        return {**data, **{key: _name(data[key], key) for key in _NAMED if key in data}}

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
        raise refusal(error, "", data, _find_allowed_keys) from error


def read_robot_toml(path: Path) -> RobotTable:
    """Read and validate a robot.toml.

    Raises
    ------
    RobotFileError
        Naming file, key, what was got and what is allowed.
    """
    with RobotFileError.where_unreadable(path):
        data = read_toml(path, expected="a robot.toml")
    try:
        return RobotTable.model_validate(data)
    except ValidationError as error:
        key, reason = first_complaint(error, data, _find_allowed_keys)
        raise RobotFileError(path, reason, key) from error


TABLES: dict[str, tuple[type[BaseModel], ...]] = {
    "inertias": (InertiasTable, LinkTable),
    "actuation": (ActuationTable,),
    "actuator": (JointActuator, Wrench, Thruster, Tendon),
    "drive": (DriveTable,),
    "constraint": tuple(kind.Keys for kind in CONSTRAINTS.values()),
    "elastic": (ElasticTable,),
    "motor": (MotorTable,),
    "spring": (QuarticSpringTable,),
    "spring_damper": (SpringDamperTable,),
    "payload": (PayloadTable,),
    "initial": (InitialTable,),
    "visual": (VisualTable,),
    "collision_sphere": (CollisionSphereTable,),
    "part": (PartTable,),
}


def _find_allowed_keys(loc: tuple[int | str, ...]) -> list[str]:
    """Keys of the table that an unknown key stands in."""
    if len(loc) == 1:
        return [field.alias or name for name, field in RobotTable.model_fields.items()]
    candidates = TABLES[str(loc[0])]
    tagged = [c for c in candidates if any(step in types_of(c) for step in loc[1:])]
    return [name for table in (tagged or candidates)[:1] for name in table.model_fields]


def types_of(table: type[BaseModel]) -> tuple[str, ...]:
    """Words for the type of such a table; none where there is one type."""
    field = table.model_fields.get("type")
    return tuple(getattr(field.annotation, "__args__", ())) if field is not None else ()
