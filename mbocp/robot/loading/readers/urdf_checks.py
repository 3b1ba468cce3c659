"""Checks of a URDF: its links and joints are one tree, its joints lose no negative energy.

Pinocchio drops links without a path to the root.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from mbocp._text import find_repeated, has_control_characters, list_names, show
from mbocp.exceptions import RobotFileError, UnsupportedRobot
from mbocp.robot.loading.description import Oddity
from mbocp.robot.loading.readers.urdf_inertia import Inertial, read_inertials
from mbocp.robot.loading.readers.urdf_xml import child_attribute, finite_number, finite_numbers

MAX_MOVING_JOINTS = 1000  # joints; loading takes nv^2 memory and nv^3 time
MAX_CHAIN_LENGTH = 1200  # joints; the stack of a thread (8 MB) ends somewhere between 2000 and 4000

_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_WITH_AXIS = ("revolute", "continuous", "prismatic", "planar")
_MAX_NAME_LENGTH = 255  # characters; names become those of files and of lines on a terminal
_MAX_NAMES = 5  # links named in one message
_NORM_RANGE = (1e-9, 1e9)  # of an axis; far beyond, its square is no number any more
_TOLERANCE = 0.02  # of the largest moment of inertia: numbers with few digits
_MAX_RADIUS = 3.0  # [m] of gyration; larger links are rare, and mm in place of m are not
_WITH_LIMITS = ("revolute", "prismatic")


def check_tree(path: Path, root: ElementTree.Element) -> None:
    """Check names, joint types, axes and the tree.

    Raises
    ------
    RobotFileError, UnsupportedRobot
        Naming the link or joint.
    """
    links = _names(path, root, "link")
    joints = dict(zip(_names(path, root, "joint"), root.iterfind("joint"), strict=True))
    if has_control_characters(root.get("name", "")):
        raise RobotFileError(path, f"its name {show(root.get('name'))} has control characters")
    if not links:
        raise RobotFileError(path, "has no link")
    parents = _parents(path, joints, set(links))
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        raise RobotFileError(
            path,
            "must have exactly one root link (one that is no joint's child), has "
            f"{list_names(roots, _MAX_NAMES) if roots else 'none'}",
        )
    depths = _depths(parents, roots[0])
    _check_reach(path, [link for link in links if link not in depths], parents, roots[0])
    _check_size(path, joints.values(), max(depths.values()))


def _parents(
    path: Path, joints: dict[str, ElementTree.Element], known: set[str]
) -> dict[str, tuple[str, str]]:
    """Joint of each link that has one, and the link that it hangs on."""
    parents: dict[str, tuple[str, str]] = {}
    for name, joint in joints.items():
        _check_joint(path, name, joint)
        parent, child = (_end(path, name, joint, end, known) for end in ("parent", "child"))
        if parent == child:
            raise RobotFileError(path, f"joint {show(name)} joins link {show(child)} to itself")
        if child in parents:
            raise RobotFileError(
                path,
                f"link {show(child)} is the child of two joints, {show(parents[child][0])} and "
                f"{show(name)}: a URDF is a tree; close loops with [[constraint]] in a robot.toml",
            )
        parents[child] = (name, parent)
    return parents


def _check_size(path: Path, joints: Iterable[ElementTree.Element], depth: int) -> None:
    """Parsers of C++ call themselves for each link in a row, until the stack ends without a word."""
    moving = sum(joint.get("type") != "fixed" for joint in joints)
    if moving > MAX_MOVING_JOINTS:
        raise UnsupportedRobot(
            f"{path}: has {moving:,} joints that move; supported are at most {MAX_MOVING_JOINTS:,}. Make "
            "some of them fixed"
        )
    if depth > MAX_CHAIN_LENGTH:
        raise UnsupportedRobot(
            f"{path}: has {depth:,} joints one behind the other; supported are at most {MAX_CHAIN_LENGTH:,}. "
            "Merge links that do not move against each other"
        )


def _depths(parents: dict[str, tuple[str, str]], root: str) -> dict[str, int]:
    """Number of joints between the root and each link that hangs on it."""
    below: dict[str, list[str]] = {}
    for child, (_, parent) in parents.items():
        below.setdefault(parent, []).append(child)
    found, waiting = {root: 0}, [root]
    for link in waiting:  # it grows
        found |= dict.fromkeys(below.get(link, ()), found[link] + 1)
        waiting += below.get(link, ())
    return found


def _check_reach(path: Path, lost: list[str], parents: dict[str, tuple[str, str]], root: str) -> None:
    """Every link hangs on the root; with one parent each, those that do not hang on a circle of links."""
    if lost:
        joints = list_names([parents[link][0] for link in lost], _MAX_NAMES)
        raise RobotFileError(
            path,
            f"links that do not hang on the root link {show(root)}: {list_names(lost, _MAX_NAMES)}; their "
            f"joints ({joints}) lead in a circle. A URDF is a tree; close loops with [[constraint]] in a "
            "robot.toml",
        )


def _check_joint(path: Path, name: str, joint: ElementTree.Element) -> None:
    kind, where = joint.get("type"), f"joint {show(name)}"
    if kind not in _JOINT_TYPES:
        raise UnsupportedRobot(
            f"{path}: {where} is of type {show(kind)}; supported: {', '.join(_JOINT_TYPES)} "
            "(and mimic on revolute, continuous and prismatic joints)"
        )
    if kind in _WITH_LIMITS and joint.find("limit") is None:
        raise RobotFileError(path, f"{where} is {kind}, and has no <limit>; zeros in it mean no limits")
    for key in ("xyz", "rpy"):
        finite_numbers(path, f"{where}: origin {key}", child_attribute(joint, "origin", key), (0.0,) * 3)
    text = child_attribute(joint, "axis", "xyz")
    axis = finite_numbers(path, f"{where}: axis xyz", text, (1.0, 0.0, 0.0))
    if kind in _WITH_AXIS and not _NORM_RANGE[0] <= np.abs(axis).max() <= _NORM_RANGE[1]:
        raise RobotFileError(path, f"{where}: axis xyz is {show(text)}, expected a direction, such as 0 0 1")


def _end(path: Path, name: str, joint: ElementTree.Element, end: str, links: set[str]) -> str:
    link = child_attribute(joint, end, "link")
    if link is None or link not in links:
        raise RobotFileError(path, f"joint {show(name)}: its {end} link {show(link)} is not defined")
    return link


def _names(path: Path, root: ElementTree.Element, tag: str) -> list[str]:
    names = [element.get("name") or "" for element in root.iterfind(tag)]
    if "" in names:
        raise RobotFileError(path, f"a <{tag}> has no name")
    wrong = next((n for n in names if len(n) > _MAX_NAME_LENGTH or has_control_characters(n)), None)
    if wrong is not None:
        raise RobotFileError(
            path,
            f"{tag} {show(wrong)}: its name has {len(wrong)} characters, expected at most "
            f"{_MAX_NAME_LENGTH}, no control characters among them",
        )
    if repeated := find_repeated(names):
        raise RobotFileError(path, f"{tag} {show(repeated[0])} is defined more than once")
    return names


def check_losses(path: Path, root: ElementTree.Element) -> None:
    """Check ``<dynamics damping= friction=>`` of every joint.

    Raises
    ------
    RobotFileError, UnsupportedRobot
        Naming the joint, for what is no number, and for what is negative.
    """
    for joint in root.iterfind("joint"):
        for key in ("damping", "friction"):
            where = f"joint {show(joint.get('name'))}: {key}"
            (value,) = finite_numbers(path, where, child_attribute(joint, "dynamics", key), (0.0,))
            if value < 0.0:
                raise UnsupportedRobot(
                    f"{path}: {where} is {value:g}; it takes energy out, and cannot be negative"
                )


def find_oddities(path: Path, root: ElementTree.Element) -> Iterator[Oddity]:
    """Find what is odd in a URDF.

    Parameters
    ----------
    path : Path
    root : Element
        ``<robot>``.
    """
    moving = {child_attribute(joint, "child", "link") for joint in root.iterfind("joint")}
    for inertial in read_inertials(path, root):
        if inertial.link in moving:
            yield from (Oddity(words, link=inertial.link) for words in _of_inertia(inertial))
    for joint in root.iterfind("joint"):
        yield from (Oddity(words, joint.get("name", ""), key=key) for words, key in _of_joint(joint))


def _of_inertia(inertial: Inertial) -> Iterator[str]:
    """What is odd about the inertia of a link, without its name."""
    moments = np.linalg.eigvalsh(inertial.inertia)
    size = float(np.abs(moments).max())
    if inertial.mass > 0.0 and size == 0.0:
        yield f"{inertial.mass:g} kg without inertia: a point, which nothing resists to turn"
    elif inertial.mass == 0.0 and size > 0.0:
        yield "inertia without mass: right for a rotor, else a number is missing"
    elif moments[2] > (1.0 + _TOLERANCE) * (moments[0] + moments[1]):
        principal = ", ".join(f"{m:.3g}" for m in moments)
        yield (
            f"its principal moments {principal} kg m^2 violate the triangle inequality: the "
            "largest is above the sum of the others; no body has that"
        )
    if inertial.mass > 0.0 and math.sqrt(size / inertial.mass) > _MAX_RADIUS:
        radius = math.sqrt(size / inertial.mass)
        what = f"{size:.3g} kg m^2 for {inertial.mass:g} kg"
        yield f"{what} is a body {2 * radius:.3g} m across: are the units right?"


def _of_joint(joint: ElementTree.Element) -> Iterator[tuple[str, str]]:
    """What is odd about one joint, without its name, and the key that says otherwise."""
    kind = joint.get("type")
    if (leader := child_attribute(joint, "mimic", "joint")) is not None:
        words = (
            f"mimics {show(leader)} in the file, and moves by itself here: robot.mimic = true couples them"
        )
        yield words, "robot.mimic"
        return
    if kind not in (*_WITH_LIMITS, "continuous"):
        return
    limit = {
        key: finite_number(child_attribute(joint, "limit", key))
        for key in ("lower", "upper", "effort", "velocity")
    }
    if kind in _WITH_LIMITS and limit["lower"] is not None and limit["upper"] is not None:
        yield from _of_range(limit["lower"], limit["upper"])
    for key in ("effort", "velocity"):
        if not limit[key]:
            what = "no" if limit[key] is None else "zero"
            words = f"{what} {key} in <limit>: limits.{key} = true does not bound it"
            if key == "effort":
                yield f"{words}; without a motor, leave it out of robot.actuated", "robot.actuated"
            else:
                yield words, ""


def _of_range(lower: float, upper: float) -> Iterator[tuple[str, str]]:
    if lower > upper:
        yield f"its lower limit {lower:g} is above its upper {upper:g}: each is taken for the other", ""
    elif lower == upper != 0.0:
        yield f"its limits are both {lower:g}: limits.position = true does not bound it", ""
    elif lower > 0.0 or upper < 0.0:
        words = "exclude zero, where poses begin unless start.q says another"
        yield f"its limits {lower:g} ... {upper:g} {words}", "start.q"
