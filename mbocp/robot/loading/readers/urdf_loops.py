"""Loops that a URDF closes by <constraint>, of which there are two proposals.

That of urdfdom's pull request 264 has <parent>, <parent_origin>, <parent_axis> and the same of the child.
That of the MIT's URDF-Parser has <predecessor> and <successor> with an <origin> each, whose points coincide.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from mbocp._text import show
from mbocp.exceptions import RobotFileError, UnsupportedRobot
from mbocp.robot.loading.readers.urdf_xml import child_attribute, finite_numbers

LEFT_OUT = ("loop", "coupling", "loop_joint")  # tags of other proposals
_KINDS = {"link": "weld", "fixed": "weld", "spherical": "point", "revolute": "hinge", "position": "point"}
_ZERO = (0.0, 0.0, 0.0)


def read_loops(path: Path, root: ElementTree.Element) -> list[dict[str, Any]]:
    """Return the tables of constraints, as of a robot.toml.

    Raises
    ------
    RobotFileError, UnsupportedRobot
        Naming the constraint.
    """
    return [_table(path, root, element) for element in root.iterfind("constraint")]


def _table(path: Path, root: ElementTree.Element, element: ElementTree.Element) -> dict[str, Any]:
    name, kind = element.get("name", ""), element.get("type", "")
    where = f"constraint {show(name)}"
    if not name:
        raise RobotFileError(path, "a <constraint> has no name")
    if kind not in _KINDS:
        words = f"is of type {show(kind)}; supported: {', '.join(_KINDS)}"
        raise UnsupportedRobot(f"{path}: {where} {words}; [[constraint]] of a robot.toml has others")
    tags = ("predecessor", "successor") if kind == "position" else ("parent", "child")
    links = tuple(_link(path, root, element, tag, where) for tag in tags)
    table: dict[str, Any] = {"type": _KINDS[kind], "name": name, "frames": links}
    for tag, suffix in zip(tags, ("", "_b"), strict=True):
        origin = element.find(f"{tag}/origin" if kind == "position" else f"{tag}_origin")
        for key, attribute in (("position", "xyz"), ("orientation", "rpy")):
            text = None if origin is None else origin.get(attribute)
            what = f"{where}: {attribute} of the {tag}'s origin"
            table[key + suffix] = finite_numbers(path, what, text, _ZERO).tolist()
    if kind == "revolute":
        table["axis"] = _axis(path, element, where)
    return table


def _link(path: Path, root: ElementTree.Element, element: ElementTree.Element, tag: str, where: str) -> str:
    link = child_attribute(element, tag, "link") or ""
    names = [one.get("name") for one in root.iterfind("link")]
    if link not in names:
        raise RobotFileError(path, f"{where}: <{tag} link={show(link)}>, expected a link of the robot")
    return link


def _axis(path: Path, element: ElementTree.Element, where: str) -> list[float]:
    """The axis of both frames, which coincide up to a turn about it."""
    parent, child = (
        finite_numbers(path, f"{where}: xyz of <{tag}>", child_attribute(element, tag, "xyz"), _ZERO)
        for tag in ("parent_axis", "child_axis")
    )
    if not parent.any():
        raise RobotFileError(path, f"{where}: a revolute one needs <parent_axis xyz>, which is not zero")
    if child.any() and np.linalg.norm(np.cross(parent, child)) > 1e-9 * np.linalg.norm(parent) ** 2:
        words = (
            f"<child_axis> is {child.tolist()}, expected none, or that of <parent_axis>: the frames share it"
        )
        raise RobotFileError(path, f"{where}: {words}")
    return [float(x) for x in parent]
