"""robot.yaml: the layout in which public collections of parallel robots keep loops beside a URDF.

    closed_loop: [['frameA', 'frameB'], ...]    # frames that coincide
    type: ['6d', '3d', ...]                     # in position and orientation, or in position; default 6d
    name_mot: ['joint', ...]                    # joints with motors; default all
    joint_name: ['joint', ...]                  # joints that are of another type than in the URDF
    joint_type: ['SPHERICAL', 'FIXED', 'UJOINT_XY', ...]
    undriven: 'hold' or 'free'                  # rods that turn about themselves; default hold

It becomes a `RobotTable`, as if it were a robot.toml, and a URDF with the other joint types.

A few lines of YAML can stand for billions of entries (aliases of lists of aliases), so the size of what a
text stands for is counted from the parser's events before anything is built.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from os.path import commonprefix
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from mbocp._files import MEGABYTE, read_text
from mbocp._text import show, warn_caller
from mbocp.exceptions import RobotFileError, Unreadable, suggest
from mbocp.robot.loading.description import Description, Oddity, ReadOptions
from mbocp.robot.loading.readers import urdf as urdf_reader
from mbocp.robot.loading.readers.urdf import describe_urdf, read_urdf
from mbocp.robot.loading.readers.urdf_xml import Urdf
from mbocp.robot.loading.robot_toml import ActuationTable, RobotTable
from mbocp.robot.loops.kinds.constraint import ConstraintKeys
from mbocp.robot.loops.kinds.hinges import Weld
from mbocp.robot.loops.kinds.kept_points import PointOnPoint
from mbocp.robot.warnings import IgnoredKeysWarning

MAX_BYTES = MEGABYTE // 4  # of a robot.yaml [bytes]; the parser is slow, the largest that we know has 3 kB
_AXES = {"X": "1 0 0", "Y": "0 1 0", "Z": "0 0 1"}
_JOINT_TYPES = ("SPHERICAL", "FIXED", *(f"UJOINT_{a}{b}" for a in _AXES for b in _AXES if a != b))
MAX_NODES = 20_000  # names, lists and tables, each as often as aliases repeat it
MAX_LEVELS = 20  # of lists and tables within each other


class RobotYaml(BaseModel):
    """Content of a robot.yaml."""

    model_config = ConfigDict(extra="allow", frozen=True, defer_build=True)

    closed_loop: list[tuple[str, str]] = Field(min_length=1)
    type: list[Literal["3d", "6d", "3D", "6D"]] | None = None
    name_mot: list[str] | None = None
    joint_name: list[str] = []
    joint_type: list[str] = []
    undriven: Literal["free", "hold"] = "hold"

    @field_validator("closed_loop")
    @classmethod
    def _two_frames(cls, pairs: list[tuple[str, str]]) -> list[tuple[str, str]]:
        if twice := next((a for a, b in pairs if a == b), None):
            raise ValueError(f"frames must be two different frames, got {show(twice)} twice")
        return pairs

    def table(self, urdf: Urdf) -> RobotTable:
        """Loops and motors as the tables of a robot.toml."""
        kinds = self.type or ["6d"] * len(self.closed_loop)
        names = _names(self.closed_loop)
        loops: list[ConstraintKeys] = [
            PointOnPoint.Keys(type="point", name=name, frames=frames)
            if kind.lower() == "3d"
            else Weld.Keys(type="weld", name=name, frames=frames)
            for name, frames, kind in zip(names, self.closed_loop, kinds, strict=True)
        ]
        balls = [n for n, t in zip(self.joint_name, self.joint_type, strict=True) if t == "SPHERICAL"]
        return RobotTable(
            description=f"Closed loops of {urdf.name}",
            actuation=ActuationTable(joints=self.name_mot),
            constraint=loops,
            spherical=balls,
            undriven=self.undriven,
        )

    def with_joints(self, urdf: Urdf, path: Path) -> Urdf:
        """The URDF with the joints that are of another type here."""
        root = deepcopy(urdf.root)
        joints = {joint.get("name", ""): joint for joint in root.iterfind("joint")}
        for name, kind in zip(self.joint_name, self.joint_type, strict=True):
            if name not in joints:
                raise RobotFileError(
                    path, f"the URDF has no joint {name!r}: {suggest(name, joints)}", "joint_name"
                )
            if kind not in _JOINT_TYPES:
                reason = f"unknown type {kind!r} of joint {name!r}; {suggest(kind, _JOINT_TYPES)}"
                raise RobotFileError(path, reason, "joint_type")
            if kind.startswith("UJOINT"):
                _split(root, joints[name], kind[-2:])
            else:
                joints[name].set("type", "fixed" if kind == "FIXED" else "floating")
        return Urdf(urdf.path, ElementTree.tostring(root, encoding="unicode"), root)


def read(path: Path, name: str, how: ReadOptions) -> Description:
    """Read a URDF with a robot.yaml beside it.

    Mimic joints are joints of their own unless told otherwise: these collections may have motors on them.
    """
    told = read_robot_yaml(path)
    urdf = read_urdf(_model_file(path))
    table, urdf = told.table(urdf), told.with_joints(urdf, path)
    found = describe_urdf(urdf, replace(how, mimic=bool(how.mimic)))
    loops = [*found.table.constraints, *table.constraints]
    return replace(found, name=name, file=path, table=table.model_copy(update={"constraints": loops}))


def companions(path: Path) -> tuple[Path, ...]:
    """The URDF, and what belongs to it."""
    model = _model_file(path)
    return (model, *urdf_reader.companions(model))


def addresses(path: Path) -> tuple[str, ...]:
    """Addresses of the meshes of the URDF."""
    return urdf_reader.addresses(_model_file(path))


def oddities(path: Path) -> Iterator[Oddity]:
    """What is odd in the URDF."""
    return urdf_reader.oddities(_model_file(path))


def _model_file(path: Path) -> Path:
    """The URDF beside a robot.yaml: robot.urdf, or the only one."""
    held = sorted(path.parent.glob("*.urdf"))
    return path.parent / "robot.urdf" if len(held) != 1 else held[0]


def read_robot_yaml(path: Path) -> RobotYaml:
    """Read and validate a robot.yaml.

    Raises
    ------
    RobotFileError
        Naming file, key, what was got and what is allowed.

    Warns
    -----
    IgnoredKeysWarning
        For keys that are not known.
    """
    with RobotFileError.where_unreadable(path):
        data = parse_yaml(read_text(path, expected="a robot.yaml", limit=MAX_BYTES))
    if not isinstance(data, dict):
        raise RobotFileError(path, "expected keys and values: closed_loop, type, name_mot, ...")
    try:
        found = RobotYaml.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = "".join(f"[{step}]" if isinstance(step, int) else f"{step}" for step in first["loc"])
        got = "" if first["type"] == "missing" else f"got {show(first['input'])}: "
        raise RobotFileError(path, f"{got}{first['msg']}", key) from error
    _check_lengths(path, found)
    if found.model_extra:
        unknown, known = ", ".join(map(repr, found.model_extra)), ", ".join(RobotYaml.model_fields)
        warn_caller(
            f"{path}: what {unknown} says is left out (known keys: {known}); a robot.toml in this folder can "
            "say more, and takes the place of the robot.yaml",
            IgnoredKeysWarning,
        )
    return found


def _check_lengths(path: Path, found: RobotYaml) -> None:
    if found.type is not None and len(found.type) != len(found.closed_loop):
        reason = f"has {len(found.type)} entries for {len(found.closed_loop)} pairs of closed_loop"
        raise RobotFileError(path, reason, "type")
    if len(found.joint_type) != len(found.joint_name):
        reason = f"has {len(found.joint_type)} entries for {len(found.joint_name)} of joint_name"
        raise RobotFileError(path, reason, "joint_type")


def _names(pairs: list[tuple[str, str]]) -> list[str]:
    """Common part of the names of two frames, if it differs from loop to loop; else loop_1, loop_2, ..."""
    common = [commonprefix(pair).rstrip("_-. ") for pair in pairs]  # noqa: RUF071  # of names, not of paths
    telling = all(common) and len(set(common)) == len(common)
    return common if telling else [f"loop_{number}" for number in range(1, len(pairs) + 1)]


def _split(root: ElementTree.Element, joint: ElementTree.Element, axes: str) -> None:
    """Make a joint into a universal one: two hinges with a massless cross between them."""
    name, child = joint.get("name", ""), joint.find("child")
    if child is None:
        return
    cross = f"{name}_cross"
    ElementTree.SubElement(root, "link", name=cross)
    second = ElementTree.SubElement(root, "joint", name=f"{name}_{axes[1]}", type="continuous")
    ElementTree.SubElement(second, "parent", link=cross)
    ElementTree.SubElement(second, "child", link=child.get("link", ""))
    ElementTree.SubElement(second, "axis", xyz=_AXES[axes[1]])
    for tag in ("axis", "limit", "mimic"):
        for element in joint.findall(tag):
            joint.remove(element)
    joint.set("name", f"{name}_{axes[0]}")
    joint.set("type", "continuous")
    child.set("link", cross)
    ElementTree.SubElement(joint, "axis", xyz=_AXES[axes[0]])


_Safe: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast, where it was built


class _Loader(_Safe):  # type: ignore[misc]  # yaml has no types
    """YAML's safe loader without its numbers, dates and truth values: 2020-13-45 or `on` is a name."""


for _kind in ("bool", "int", "float", "timestamp", "binary"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Safe.construct_yaml_str)


def parse_yaml(text: str) -> Any:
    """Lists, tables, texts and None of a YAML text.

    Raises
    ------
    Unreadable
        If it is not YAML, with line and column, is nested too deeply or stands for too many entries.
    """
    try:
        _check_size(text)
        return yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        raise Unreadable(f"malformed YAML: {' '.join(str(error).split())}") from error


def _check_size(text: str) -> None:
    """Count the nodes, those of aliases each time, and stop at the limits."""
    anchors: dict[str | None, int] = {}  # nodes of each anchor
    open_: list[tuple[str | None, int]] = []  # what has not ended: its anchor, and nodes before it
    count = 0
    for event in yaml.parse(text, Loader=_Safe):
        if isinstance(event, yaml.AliasEvent):
            if any(anchor == event.anchor for anchor, _ in open_):
                raise Unreadable(f"malformed YAML: *{event.anchor} stands within itself")
            count += anchors.get(event.anchor, 1)
        elif isinstance(event, yaml.NodeEvent):
            open_.append((event.anchor, count))
            count += 1
        if isinstance(event, yaml.ScalarEvent | yaml.CollectionEndEvent):
            anchor, before = open_.pop()
            anchors[anchor] = count - before
        if len(open_) > MAX_LEVELS:
            raise Unreadable(f"malformed YAML: lists or tables are nested more than {MAX_LEVELS} deep")
        if count > MAX_NODES:
            raise Unreadable(
                f"malformed YAML: stands for more than {MAX_NODES} entries, each counted as often as "
                "aliases repeat it"
            )
