"""Keys of `[robot]` and of its parts: what is loaded, and how.

They are declared here, and nowhere else: problem files, `load_robot`, `load_parts` and the table that loads a
robot again take them from here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import pinocchio as pin
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from mbocp._arrays import plain
from mbocp._keys import Key, KeyGroup, Kind
from mbocp._quantities import check_named_numbers, finite_number
from mbocp._text import has_control_characters, show
from mbocp.exceptions import InvalidValue, RobotError, suggest
from mbocp.robot.kinematics import WORLD, placement_from
from mbocp.robot.loading.addresses import absolute
from mbocp.robot.loading.joint_numbers import FrictionModel
from mbocp.robot.loading.robot_tables import (
    ElasticTable,
    InertiasTable,
    MotorTable,
    PayloadTable,
    Positive,
    ShapeTable,
)
from mbocp.robot.loading.table_types import Orientation, Position, refusal
from mbocp.robot.parts import Rotations
from mbocp.robot.payload import SHAPES, Payload
from mbocp.robot.placed import SEPARATOR


def _name(value: Any) -> str:
    if not isinstance(value, str) or not value or SEPARATOR in value or has_control_characters(value):
        raise ValueError(f"got {show(value)}, expected a name without {SEPARATOR!r}")
    if value == WORLD:
        raise ValueError(f"got {show(value)}, which is the frame that stands still; take another name")
    return value


def _lock(value: Any) -> Any:
    if isinstance(value, list) and all(isinstance(name, str) for name in value):
        return value
    if isinstance(value, Mapping):
        return check_named_numbers(value)
    raise ValueError(f"got {show(value)}, expected a list of joint names or a table with a position for each")


def _arguments(value: Any) -> Any:
    allowed = (str, bool, int, float)
    if isinstance(value, Mapping) and all(isinstance(one, allowed) for one in value.values()):
        return dict(value)
    raise ValueError(f"got {show(value)}, expected a table with a text, number or boolean for each argument")


_OWN = "the robot's"
Number = Annotated[float, Kind("number", finite_number, float)]
Lock = Annotated[Any, Kind("table or list of names", _lock, list[str] | dict[str, float | list[float]])]
Arguments = Annotated[Any, Kind("table", _arguments, dict[str, str | bool | int | float])]

_OF_OBJECTS = ("mass", "com", "inertia", *SHAPES)
OF_FILES = (
    "free_flyer",
    "mimic",
    "dynamics",
    "inertias",
    "damping",
    "friction",
    "friction_speed",
    "arguments",
)  # how one file is read
_OF_ROBOTS = ("lock", "actuated", *OF_FILES[1:], "package_dirs")


class ReadingKeys(KeyGroup):
    """How a robot is read: keys of `[robot]`, and of each part beside others."""

    free_flyer: Annotated[bool | None, Key("whether the root link floats", "", _OWN)] = None
    lock: Annotated[Lock, Key("joints made rigid, and where", "rad, m", _OWN)] = None
    actuated: Annotated[
        list[str] | None,
        Key("joints with motors, in the order of u; others are passive", "", _OWN, "list of names"),
    ] = None
    mimic: Annotated[
        bool | None,
        Key(
            "whether mimic joints follow their leader",
            default="true; false for robot.yaml and names of example-robot-data",
        ),
    ] = None
    dynamics: Annotated[
        bool | None,
        Key(
            "`false`: controls are accelerations ([without inertias](robots.md#robots-without-inertias))",
            default=f"{_OWN}, else true",
        ),
    ] = None
    inertias: Annotated[
        InertiasTable | None, Key("masses and inertias beside the file's", default=f"{_OWN}, else none")
    ] = None
    damping: Annotated[
        bool | None,
        Key("whether [viscous damping](robots.md#damping-and-friction) acts", default=f"{_OWN}, else true"),
    ] = None
    friction: Annotated[
        FrictionModel | None,
        Key("whether its Coulomb friction acts", default=f"{_OWN}, else left out, and told"),
    ] = None
    friction_speed: Annotated[
        Positive | None, Key("speed over which friction is smoothed", "rad/s, m/s", f"{_OWN}, else 0.1")
    ] = None
    arguments: Annotated[Arguments | None, Key("of a [xacro file](robots.md#xacro)", "", _OWN)] = None
    package_dirs: Annotated[list[str], Key("where `package://` leads", "", "none", "list of paths")] = Field(
        default=[]
    )
    payload: Annotated[
        list[PayloadTable] | None, Key("[bodies that it carries](robots.md#payloads)", "", _OWN)
    ] = None

    def folders(self, base: Path | None) -> tuple[Path, ...]:
        """Absolute paths of the folders with packages."""
        return tuple(absolute(folder, base) for folder in self.package_dirs)

    def portable(self, base: Path | None, *left_out: str) -> dict[str, Any]:
        """The keys that say something, with absolute paths; what is carried in the end names itself."""
        told = self._find_keys_said(
            name for name in type(self).model_fields if name not in ("payload", *left_out)
        )
        said = plain({name: _plain(getattr(self, name)) for name in told})
        folders = {"package_dirs": [str(folder) for folder in self.folders(base)]}
        return {**said, **(folders if self.package_dirs else {})}

    def _find_keys_said(self, keys: Iterable[str]) -> list[str]:
        """Keys with another value than the default."""
        fields = type(self).model_fields
        return [key for key in keys if getattr(self, key) != fields[key].default]


class PartTable(ReadingKeys, ShapeTable):
    """A robot or a simple body, and the frame that its base is fixed to."""

    robot: Annotated[str | None, Key("name or path, as `robot.name`", default="required, or `mass`")] = None
    name: Annotated[str, BeforeValidator(_name), Key("of the part; without `/`")]
    parent: Annotated[str, Key('frame that carries the base, as `"left/tool0"`')] = WORLD
    position: Annotated[Position, Key("of the part's base in `parent`", "m", "0", "3 numbers")] = (
        0.0,
        0.0,
        0.0,
    )
    orientation: Annotated[
        Orientation,
        Key("of the base: roll, pitch, yaw, or a quaternion x, y, z, w", "rad", "none", "3 or 4 numbers"),
    ] = (0.0, 0.0, 0.0, 1.0)

    @model_validator(mode="after")
    def _a_robot_or_an_object(self) -> PartTable:
        told = self._find_keys_said(_OF_OBJECTS)
        if self.robot is not None:
            if told:
                raise ValueError(f"{told[0]}: does not go with robot; it makes a part a body of its own")
            return self
        if not told:
            raise ValueError(
                f"robot is missing: name or path; or give mass and {', '.join(SHAPES)} of a simple body"
            )
        for key in self._find_keys_said(_OF_ROBOTS):
            raise ValueError(f"{key}: is a matter of robots; a simple body has no joints of its own")
        self._check_object()
        return self

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
        return shape if any(shape.inertia) else replace(shape, inertia=shape.solid_inertia)

    @property
    def placement(self) -> pin.SE3:
        """Of the base in the parent frame."""
        return placement_from(self.position, self.orientation)


class _HeadKeys(KeyGroup):
    name: Annotated[
        str | None, Key("name of a robot, or path of a URDF or `robot.toml`", "", "required, or `robot.part`")
    ] = None
    part: Annotated[
        list[PartTable] | None, Key("[several robots in one world](robots.md#several-robots-in-one-world)")
    ] = None


class RobotKeys(ReadingKeys, _HeadKeys):
    """`[robot]`: a robot with its name or path, or parts in one world with what joins them."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, defer_build=True)

    gravity: Annotated[
        list[Number] | None,
        Field(min_length=3, max_length=3),
        Key(
            "in the world; turn it for robots on walls or ceilings",
            *("m/s^2", f"{_OWN}, else `[0, 0, -9.81]`", "3 numbers"),
        ),
    ] = None
    rotations: Annotated[
        Rotations | None,
        Key("what explicit schemes [integrate](robots.md#rotations)", default=f'{_OWN}, else `"quaternion"`'),
    ] = None
    numbers: Annotated[
        dict[str, Number] | None,
        Key(
            '[other numbers](parameters.md), as `"joint.elbow.length" = 0.4`',
            "those of the number",
            default="those of its files",
            takes="table",
        ),
    ] = None
    label: Annotated[str | None, Key("what to call it in output", "", "the robot's name")] = None
    elastic: Annotated[
        list[ElasticTable] | None,
        Key("[elastic joints](robots.md#elastic-joints)", default=f"{_OWN}, else none"),
    ] = None
    motor: Annotated[
        list[MotorTable] | None,
        Key("[motors with gears](robots.md#motors-with-gears)", "", f"{_OWN}, else none"),
    ] = None
    constraint: Annotated[
        list[dict[str, Any]] | None,
        Key("[what joins parts](robots.md#parts-that-are-joined)", takes="tables"),
    ] = None
    initial: Annotated[
        dict[str, Any] | None, Key("`q` by joint or part", "", "that of the parts", "table")
    ] = None

    @model_validator(mode="after")
    def _a_name_or_parts(self) -> RobotKeys:
        if self.name is None and self.part is None:
            raise ValueError("name is missing: name or path of a robot; or give tables [[robot.part]]")
        return self


def read_part(entry: PartTable | Mapping[str, Any], number: int) -> PartTable:
    """Read a part from a table.

    Raises
    ------
    RobotError
        For an unknown or missing key or a wrong value, naming it.
    """
    if isinstance(entry, PartTable):
        return entry
    try:
        return PartTable.model_validate(plain(entry))
    except ValidationError as error:
        raise refusal(error, f"part[{number}]", entry, _find_allowed_keys) from error


def _plain(value: Any) -> Any:
    """A value, or what tables say that are in it."""
    if isinstance(value, BaseModel):
        return value.model_dump(exclude_defaults=True)
    return [_plain(entry) for entry in value] if isinstance(value, list) else value


def _find_allowed_keys(loc: tuple[int | str, ...]) -> list[str]:
    """Keys of the table of a part, or of the one in it, that an unknown key stands in."""
    tables: dict[str, type[BaseModel]] = {
        "inertias": InertiasTable,
        "elastic": ElasticTable,
        "motor": MotorTable,
    }
    return list(next((tables[key] for key in tables if key in loc[:-1]), PartTable).model_fields)


def read_robot_keys(table: Mapping[str, Any]) -> RobotKeys:
    """Read the keys of `[robot]`.

    Raises
    ------
    RobotError
        For an unknown or missing key or a wrong value, naming it.
    """
    data = plain(table)
    try:
        return RobotKeys.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        if not first["loc"]:
            words = "is required: name or path of a robot; or give tables [[robot.part]]"
            raise RobotError(f"robot.name: {words}") from error
        if first["type"] == "extra_forbidden" and len(first["loc"]) == 1:
            key = str(first["loc"][0])
            raise RobotError(f"robot: unknown key {key!r}; {suggest(key, RobotKeys.model_fields)}") from error
        is_inside = first["loc"][0] in ("part", "payload") and len(first["loc"]) > 1
        where = "" if is_inside else "robot"
        raise refusal(error, where, data, _find_allowed_keys) from error
