"""Schema of robot.toml, which adds to a URDF; docs/robots.md explains each key."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

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

from mbocp._files import read_toml
from mbocp._text import has_control_characters, shown
from mbocp.exceptions import RobotError, RobotFileError, Unreadable, suggest
from mbocp.robot.loading.part_table import PartTable
from mbocp.robot.loading.payload_table import PayloadTable
from mbocp.robot.loading.placement_table import Orientation, Position

__all__ = [
    "TABLES",
    "ActuationTable",
    "CollisionSphereTable",
    "ConstraintTable",
    "CouplingTable",
    "DriveTable",
    "HingeTable",
    "InitialTable",
    "JointActuator",
    "LineTable",
    "PlaneTable",
    "PointTable",
    "QuarticSpringTable",
    "RobotTable",
    "RodTable",
    "SpringDamperTable",
    "Thruster",
    "VisualTable",
    "WeldTable",
    "Wrench",
    "read_robot_toml",
    "tables_from",
]

_MAX_VALUE = 1e15  # of numbers in the equations, as in a URDF
_MIN_DIRECTION = 1e-15  # largest component of a direction
Number: TypeAlias = Annotated[FiniteFloat, Field(ge=-_MAX_VALUE, le=_MAX_VALUE)]
PositiveNumber: TypeAlias = Annotated[PositiveFloat, Field(le=_MAX_VALUE)]
Vector3: TypeAlias = tuple[Number, Number, Number]
Numbers: TypeAlias = Number | list[Number]
Length: TypeAlias = Annotated[FiniteFloat, Field(ge=0, le=_MAX_VALUE)]
Component: TypeAlias = Literal["fx", "fy", "fz", "mx", "my", "mz"]
FramePair: TypeAlias = tuple[str, str]


def _printable(text: str) -> str:
    if has_control_characters(text.replace("\n", " ").replace("\t", " ")):
        raise ValueError("must not have control characters")
    return text


Printable: TypeAlias = Annotated[str, AfterValidator(_printable)]


def _is_zero(vector: tuple[float, float, float]) -> bool:
    return max(map(abs, vector)) < _MIN_DIRECTION


def _has_direction(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if _is_zero(vector):
        raise ValueError("must not be zero")
    return vector


Direction: TypeAlias = Annotated[Vector3, AfterValidator(_has_direction)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ActuationTable(_Table):
    """[actuation]: the joints that have motors, in the order of the controls."""

    joints: list[str] | None = None


class JointActuator(_Table):
    """A motor on a joint: one control for each velocity component of the joint."""

    type: Literal["joint"]
    joint: str
    effort: PositiveFloat | None = None


class Wrench(_Table):
    """Forces and moments on a frame, in its own axes: one control a component."""

    type: Literal["wrench"]
    frame: str
    name: str | None = None
    components: list[Component] = Field(default=["fx", "fy", "fz", "mx", "my", "mz"], min_length=1)
    effort: PositiveFloat | list[PositiveFloat] | None = None

    @model_validator(mode="after")
    def _one_effort_a_component(self) -> Wrench:
        if len(set(self.components)) != len(self.components):
            raise ValueError(f"components are repeated: {', '.join(self.components)}")
        if isinstance(self.effort, list) and len(self.effort) != len(self.components):
            raise ValueError(f"effort has {len(self.effort)} numbers for {len(self.components)} components")
        return self


class Thruster(_Table):
    """A thrust along an axis of a frame, with a reaction torque about it."""

    type: Literal["thruster"]
    frame: str
    name: str | None = None
    axis: Vector3 = (0.0, 0.0, 1.0)
    position: Vector3 = (0.0, 0.0, 0.0)
    torque_ratio: Number = 0.0
    effort: PositiveFloat | None = None

    @model_validator(mode="after")
    def _axis_has_a_direction(self) -> Thruster:
        if _is_zero(self.axis):
            raise ValueError("axis must not be zero")
        return self


class DriveTable(_Table):
    """A control that prescribes a joint's motion, or a frame's along a direction."""

    name: str | None = None
    joint: str | None = None
    frame: str | None = None
    direction: Vector3 | None = None
    joints: Annotated[list[str], Field(min_length=1)] | None = None
    control: Literal["velocity", "acceleration"]
    limit: PositiveFloat | None = None

    @model_validator(mode="after")
    def _a_joint_or_a_frame(self) -> DriveTable:
        if (self.joint is None) == (self.frame is None):
            raise ValueError("give either joint, or frame with direction and joints")
        if self.joint is not None and (self.direction, self.joints) != (None, None):
            raise ValueError("direction and joints go with frame, not with joint")
        if self.frame is not None and (self.direction is None or self.joints is None):
            raise ValueError("frame needs direction (in its own axes) and joints (those that it is moved by)")
        if self.direction is not None and _is_zero(self.direction):
            raise ValueError("direction must not be zero")
        return self


class _Pair(_Table):
    name: str | None = None
    frames: FramePair

    @model_validator(mode="after")
    def _two_frames(self) -> _Pair:
        if self.frames[0] == self.frames[1]:
            raise ValueError(f"frames must be two different frames, got {self.frames[0]!r} twice")
        return self


class _Joined(_Pair):
    """Two frames that are joined, and where in each of them the joint is."""

    position: Position | None = None
    orientation: Orientation | None = None
    position_b: Position | None = None
    orientation_b: Orientation | None = None


class RodTable(_Joined):
    """A rigid massless rod."""

    type: Literal["rod"]
    length: PositiveNumber | None = None


class PointTable(_Joined):
    """The origins of two frames coincide."""

    type: Literal["point"]


class HingeTable(_Joined):
    """The origins of two frames coincide, and an axis of one with an axis of the other."""

    type: Literal["hinge"]
    axis: Direction = (0.0, 0.0, 1.0)
    axis_b: Direction | None = None


class WeldTable(_Joined):
    """Two frames coincide."""

    type: Literal["weld"]


class PlaneTable(_Joined):
    """The origin of the first frame stays in a plane of the second."""

    type: Literal["plane"]
    normal: Direction = (0.0, 0.0, 1.0)


class LineTable(_Joined):
    """The origin of the first frame stays on a line of the second."""

    type: Literal["line"]
    axis: Direction = (0.0, 0.0, 1.0)


class CouplingTable(_Table):
    """Two joints move together."""

    type: Literal["coupling"]
    name: str | None = None
    joints: FramePair
    ratio: Number = 1.0
    offset: Number = 0.0

    @model_validator(mode="after")
    def _two_joints(self) -> CouplingTable:
        if self.joints[0] == self.joints[1]:
            raise ValueError(f"joints must be two different joints, got {self.joints[0]!r} twice")
        if self.ratio == 0.0:
            raise ValueError("ratio must not be zero; to hold a joint still, lock it")
        return self


class QuarticSpringTable(_Pair):
    """A spring with a quartic potential."""

    type: Literal["quartic"] = "quartic"
    stiffness: PositiveNumber | None = None
    coefficient: PositiveNumber | None = None
    length: PositiveNumber | None = None

    @model_validator(mode="after")
    def _one_strength(self) -> QuarticSpringTable:
        if (self.stiffness is None) == (self.coefficient is None):
            raise ValueError("give either stiffness k [N/m] or coefficient c [N/m^3]; c = k/(2 length^2)")
        return self


class SpringDamperTable(_Pair):
    """A linear spring and damper."""

    stiffness: Length = 0.0
    damping: Length = 0.0
    length: Length | None = None


class InitialTable(_Table):
    """[initial]: the initial pose, as the whole configuration or by joint."""

    q: list[Number] | dict[str, Numbers]


class VisualTable(_Table):
    """Something to draw between two frames."""

    type: Literal["rod", "spring", "line", "none"]
    frames: FramePair
    radius: PositiveNumber | None = None
    color: list[Annotated[FiniteFloat, Field(ge=0, le=1)]] | None = Field(
        default=None, min_length=3, max_length=4
    )


class CollisionSphereTable(_Table):
    """A sphere that stands for a part of a link where it may collide."""

    frame: str
    center: Vector3 = (0.0, 0.0, 0.0)
    radius: PositiveNumber


Actuator: TypeAlias = Annotated[JointActuator | Wrench | Thruster, Field(discriminator="type")]
ConstraintTable: TypeAlias = Annotated[
    RodTable | PointTable | HingeTable | WeldTable | PlaneTable | LineTable | CouplingTable,
    Field(discriminator="type"),
]


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


class RobotTable(_Table):
    """The whole file."""

    name: Printable | None = None
    description: Printable = ""
    urdf: str = "robot.urdf"
    package_dirs: list[str] = []
    free_flyer: bool | None = None
    gravity: Vector3 | None = None
    lock: list[str] | dict[str, Numbers] = []
    mimic: bool | None = None
    damping: bool | None = None
    friction: Literal["none", "smooth"] | None = None
    friction_speed: PositiveNumber | None = None
    spherical: list[str] = []
    rotations: Literal["quaternion", "dcm"] | None = None
    trace: list[str] | None = None
    actuation: ActuationTable = ActuationTable()
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
        key, reason = _first_of(error, data)
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
        key, reason = _first_of(error, data)
        raise RobotFileError(path, reason, key) from error


def _first_of(error: ValidationError, data: Any) -> tuple[str, str]:
    """Key and words of the first complaint."""
    first = error.errors()[0]
    more = f" ({error.error_count() - 1} more)" if error.error_count() > 1 else ""
    return _key(data, first["loc"], absent=first["type"] == "missing"), _reason(first, data) + more


def _key(data: Any, loc: tuple[int | str, ...], *, absent: bool) -> str:
    """Dotted key as in the file, e.g. constraint[0].frames, without pydantic's tags for unions."""
    parts: list[str] = []
    node, last = data, len(loc) - 1
    for position, step in enumerate(loc):
        if isinstance(step, int):
            parts.append(f"[{step}]")
        elif (absent and position == last) or (isinstance(node, dict) and step in node):
            parts.append(f".{step}")
        else:
            continue
        node = _child(node, step)
    return "".join(parts).lstrip(".")


def _child(node: Any, step: int | str) -> Any:
    if isinstance(node, dict):
        return node.get(step)
    return node[step] if isinstance(node, list) and isinstance(step, int) and step < len(node) else None


def _reason(error: Any, data: Any) -> str:
    kind, context, got = error["type"], error.get("ctx", {}), error["input"]
    if kind == "extra_forbidden":
        return f"unknown key; {suggest(str(error['loc'][-1]), _allowed_keys(error['loc'], data))}"
    if kind == "missing":
        return "this key is required" if isinstance(error["loc"][-1], str) else "this number is missing"
    if kind == "union_tag_not_found":
        return f"type is required: {_plain(context.get('discriminator', 'type'))}"
    if kind == "union_tag_invalid":
        return f"unknown type {shown(context['tag'])}, known: {_plain(context['expected_tags'])}"
    if kind == "literal_error":
        what = "unknown type" if error["loc"][-1] == "type" else "got"
        return f"{what} {shown(got)}, known: {_plain(context['expected'])}"
    message = error["msg"].removeprefix("Value error, ")
    return message if kind == "value_error" else f"got {shown(got)}: {message}"


def _plain(text: str) -> str:
    return text.replace("'", "").replace(" or ", ", ")


TABLES: dict[str, tuple[type[BaseModel], ...]] = {
    "actuation": (ActuationTable,),
    "actuator": (JointActuator, Wrench, Thruster),
    "drive": (DriveTable,),
    "constraint": (
        RodTable,
        PointTable,
        HingeTable,
        WeldTable,
        PlaneTable,
        LineTable,
        CouplingTable,
    ),
    "spring": (QuarticSpringTable,),
    "spring_damper": (SpringDamperTable,),
    "payload": (PayloadTable,),
    "initial": (InitialTable,),
    "visual": (VisualTable,),
    "collision_sphere": (CollisionSphereTable,),
    "part": (PartTable,),
}


def _allowed_keys(loc: tuple[int | str, ...], data: Any) -> list[str]:
    """Keys of the table that an unknown key stands in."""
    if len(loc) == 1:
        return [field.alias or name for name, field in RobotTable.model_fields.items()]
    candidates = TABLES[str(loc[0])]
    tagged = [c for c in candidates if any(step in _tags(c) for step in loc[1:])]
    return [name for table in (tagged or candidates)[:1] for name in table.model_fields]


def _tags(table: type[BaseModel]) -> tuple[str, ...]:
    field = table.model_fields.get("type")
    return tuple(getattr(field.annotation, "__args__", ())) if field is not None else ()
