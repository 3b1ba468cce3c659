"""Extensions of URDF: loops that <constraint> closes, and tags that are left out, which one warning names.

There are two proposals of <constraint>. That of urdfdom's pull request 264 has <parent>, <parent_origin>,
<parent_axis> and the same of the child. That of the MIT's URDF-Parser has <predecessor> and <successor> with
an <origin> each, whose points coincide.

Contacts (<collision>), controllers (<safety_controller>, <transmission>), sensors and colours change nothing
about the equations of motion of a mechanism in free motion, and are not told.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from mbocp._text import list_names, shorten, show, warn_caller
from mbocp.exceptions import RobotFileError, UnsupportedRobot
from mbocp.robot.loading.readers.urdf_inertia import read_inertials
from mbocp.robot.loading.readers.urdf_xml import child_attribute, finite_number, finite_numbers
from mbocp.robot.warnings import NotModelledWarning

# Tags and attributes of extensions of the format that change the equations of motion.
_SPRINGS = ("springStiffness", "spring_stiffness", "stiffness")
_ROTORS = ("rotorInertia", "rotor_inertia", "motorInertia", "motor_inertia", "armature")
_NO = ("false", "0")
_LOOP_HINT = "[[constraint]] of a robot.toml closes loops"
_KNOWN = {
    "robot": ("link", "joint", "material", "transmission", "gazebo", "sensor", "constraint"),
    "link": ("inertial", "visual", "collision"),
    "inertial": ("origin", "mass", "inertia"),
    "joint": (
        "origin",
        "parent",
        "child",
        "axis",
        "calibration",
        "dynamics",
        "limit",
        "mimic",
        "safety_controller",
    ),
}
_MIN_LIKENESS = 0.8  # from this likeness on, an unknown tag is a slip of the pen
_MAX_NAMES = 5
_LEFT_OUT = ("loop", "coupling", "loop_joint")  # tags of other proposals
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


def tell_omissions(path: Path, root: ElementTree.Element) -> None:
    """Warn of springs, rotors, loops, missing gravity, losses of joints without one axis, and misspelt tags.

    Warns
    -----
    NotModelledWarning
        Once for the robot, naming each.
    """
    told = list(dict.fromkeys([*_extensions(root), *_misspelt(root)]))
    if told:
        more = f"; and {len(told) - _MAX_NAMES} more" if len(told) > _MAX_NAMES else ""
        warn_caller(
            f"{path}: not modelled, and left out: {'; '.join(told[:_MAX_NAMES])}{more}", NotModelledWarning
        )


def _extensions(root: ElementTree.Element) -> Iterator[str]:
    for joint in root.iterfind("joint"):
        for key in (*_SPRINGS, *_ROTORS):
            if _not_zero(child_attribute(joint, "dynamics", key)):
                yield f"{_what(key)} of joint {show(joint.get('name'))} (<dynamics {key}>)"
    yield from _losses_without_an_axis(root)
    for loop in root:
        if loop.tag in _LEFT_OUT:
            yield f"the loop that <{loop.tag}> {show(loop.get('name'))} closes ({_LOOP_HINT})"
    for element in root.iterfind("gazebo"):
        yield from _gazebo(element)
    yield from _weightless(root)
    yield from _rotors(root)


def _rotors(root: ElementTree.Element) -> Iterator[str]:
    for element in root.iterfind("transmission"):
        for inner in element.iter():
            tag = inner.tag.rpartition("}")[2]
            if tag in _ROTORS and (_not_zero(inner.text) or _not_zero(inner.get("value"))):
                yield f"{_what(tag)} in <transmission> {show(element.get('name'))}"


def _losses_without_an_axis(root: ElementTree.Element) -> Iterator[str]:
    for joint in root.iterfind("joint"):
        numbers = (child_attribute(joint, "dynamics", key) for key in ("damping", "friction"))
        if joint.get("type") in ("planar", "floating") and any(_not_zero(number) for number in numbers):
            hint = "it has no one axis; a [[spring_damper]] of a robot.toml damps it"
            yield f"damping and friction of the {joint.get('type')} joint {show(joint.get('name'))} ({hint})"


def _gazebo(element: ElementTree.Element) -> Iterator[str]:
    where = f"<gazebo reference={show(element.get('reference'))}>"
    for inner in element:
        if inner.tag in _SPRINGS and _not_zero(inner.text):
            yield f"{_what(inner.tag)} of {where}"
        elif inner.tag == "joint":
            yield f"the joint {show(inner.get('name'))} in {where} ({_LOOP_HINT})"


def _weightless(root: ElementTree.Element) -> Iterator[str]:
    """Links with mass that gravity does not act upon in Gazebo."""
    heavy = {i.link for i in read_inertials(Path(), root) if i.mass > 0}
    links = [
        element.get("reference", "")
        for element in root.iterfind("gazebo")
        for inner in element
        if inner.tag in ("gravity", "turnGravityOff")
        and ((inner.text or "").strip().lower() in _NO) == (inner.tag == "gravity")
    ]
    named = [link for link in dict.fromkeys(links) if link in heavy]
    if named:
        yield f"gravity turned off for the links {list_names(named, _MAX_NAMES)} (<gazebo>)"


def _what(key: str) -> str:
    return "the spring" if key in _SPRINGS else "the rotor's inertia"


def _misspelt(root: ElementTree.Element) -> Iterator[str]:
    parents = [root, *root.iterfind("link"), *root.iterfind("joint"), *root.iterfind("link/inertial")]
    likely: dict[tuple[str, str], list[str]] = {}
    for parent in parents:
        for inner in parent:
            if inner.tag in _KNOWN[parent.tag]:
                continue
            key = (parent.tag, shorten(inner.tag.lower(), 40))
            if key not in likely:
                likely[key] = difflib.get_close_matches(key[1], _KNOWN[parent.tag], n=1, cutoff=_MIN_LIKENESS)
            if likely[key]:
                of = "" if parent is root else f" of {parent.tag} {show(parent.get('name'))}"
                yield f"<{shorten(inner.tag)}>{of} (did you mean <{likely[key][0]}>?)"


def _not_zero(text: str | None) -> bool:
    return bool(finite_number(text))
