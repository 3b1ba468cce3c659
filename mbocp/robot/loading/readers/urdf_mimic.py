"""Mimic joints of a URDF: their first leaders, and the damping and friction that Pinocchio drops."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

from mbocp._text import list_names
from mbocp.exceptions import RobotFileError, UnsupportedRobot
from mbocp.robot.loading.followers import Follower
from mbocp.robot.loading.readers.urdf_xml import finite_numbers

_KINDS = ("revolute", "continuous", "prismatic")
_MAX_NAMES = 12  # in a message
_REMEDY = "mend it, or load the robot with mimic = false"


def followers(path: Path, root: ElementTree.Element) -> tuple[Follower, ...]:
    """Mimic joints of a URDF, in its order. One that mimics a mimic joint follows that one's leader.

    Raises
    ------
    RobotFileError, UnsupportedRobot
        Naming the joint, for what Pinocchio's mimic joints cannot follow.
    """
    elements = {joint.get("name", ""): joint for joint in root.iterfind("joint")}
    return tuple(
        _check(path, _resolve(path, name, elements), elements)
        for name, joint in elements.items()
        if joint.find("mimic") is not None
    )


def with_first_leaders(text: str, root: ElementTree.Element, found: Sequence[Follower]) -> str:
    """Text of the URDF in which every mimic joint names the leader that it follows in the end."""
    named = {joint.get("name"): joint.find("mimic") for joint in root.iterfind("joint")}
    if all(_attribute(named[f.name], "joint") == f.leader for f in found):
        return text
    copy = ElementTree.fromstring(text)
    for joint in copy.iterfind("joint"):
        for follower in found:
            mimic = joint.find("mimic")
            if mimic is not None and joint.get("name") == follower.name:
                mimic.set("joint", follower.leader)
                mimic.set("multiplier", repr(follower.multiplier))
                mimic.set("offset", repr(follower.offset))
    return ElementTree.tostring(copy, encoding="unicode")


def _resolve(path: Path, name: str, elements: Mapping[str, ElementTree.Element]) -> Follower:
    """Follow the leaders up to the one that follows no other."""
    multiplier, offset, at, passed = 1.0, 0.0, name, [name]
    while (mimic := elements[at].find("mimic")) is not None:
        leader = mimic.get("joint") or ""
        who = f"joint {at!r} mimics {leader!r}"
        if leader not in elements:
            raise RobotFileError(path, f"{who}, which is not defined; {_REMEDY}")
        if leader in passed:
            raise UnsupportedRobot(
                f"{path}: joint {name!r} mimics itself, by way of {list_names(passed, _MAX_NAMES)}; {_REMEDY}"
            )
        # theta = m theta_at + o and theta_at = m' theta_leader + o'
        offset += multiplier * _number(path, who, mimic, "offset", 0.0)
        multiplier *= _number(path, who, mimic, "multiplier", 1.0)
        passed.append(leader)
        at = leader
    return _with_own(Follower(name, at, multiplier, offset), path, elements[name])


def _with_own(follower: Follower, path: Path, element: ElementTree.Element) -> Follower:
    """The follower with its limits and losses; zero or contradictory limits mean none."""
    who = f"joint {follower.name!r}"
    limit, dynamics = element.find("limit"), element.find("dynamics")
    lower, upper, velocity = (_number(path, who, limit, k, 0.0) for k in ("lower", "upper", "velocity"))
    damping, friction = (_number(path, who, dynamics, key, 0.0) for key in ("damping", "friction"))
    if lower == upper or element.get("type") == "continuous":
        lower, upper = -math.inf, math.inf
    lower, upper, velocity = min(lower, upper), max(lower, upper), velocity if velocity > 0.0 else math.inf
    return replace(follower, lower=lower, upper=upper, velocity=velocity, damping=damping, friction=friction)


def _check(path: Path, follower: Follower, elements: Mapping[str, ElementTree.Element]) -> Follower:
    kinds = (elements[follower.name].get("type"), elements[follower.leader].get("type"))
    where = f"{path}: joint {follower.name!r} mimics {follower.leader!r}"
    if not set(kinds) <= set(_KINDS) or len({kind == "continuous" for kind in kinds}) > 1:
        raise UnsupportedRobot(
            f"{where}: a {kinds[0]} joint cannot follow a {kinds[1]} one (continuous follows "
            f"continuous, revolute and prismatic follow each other); {_REMEDY}"
        )
    if kinds[0] == "continuous" and not follower.multiplier.is_integer():
        raise UnsupportedRobot(
            f"{where} with the multiplier {follower.multiplier:g}: the angle of a continuous joint is known "
            f"up to full turns, so that its multiple must be a whole one; make both revolute, {_REMEDY}"
        )
    return follower


def _number(path: Path, who: str, element: ElementTree.Element | None, key: str, default: float) -> float:
    return float(finite_numbers(path, f"{who}: {key}", _attribute(element, key), (default,))[0])


def _attribute(element: ElementTree.Element | None, key: str) -> str | None:
    return None if element is None else element.get(key)
