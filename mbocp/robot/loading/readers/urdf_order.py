"""The order in which Pinocchio takes the joints of a URDF, so that those which others mimic come first.

Pinocchio goes depth first, and by name where a link has several joints. A mimic joint must come after its
leader; so joints of such links get names that sort as they must, and their own again in the model.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from mbocp.exceptions import RobotFileError
from mbocp.robot.loading.joint_numbers import MimicJoint


def make_sorted_names(
    path: Path, root: ElementTree.Element, followers: Sequence[MimicJoint]
) -> dict[str, str]:
    """Names with which leaders sort before their followers, by the joints' own; none where they do anyway.

    Raises
    ------
    RobotFileError
        If a leader moves with its follower, or leaders of two links wait for each other.
    """
    ends = {joint.get("name", ""): joint for joint in root.iterfind("joint")}
    above = {_link(joint, "child"): name for name, joint in ends.items()}
    siblings: dict[str, dict[str, set[str]]] = {}
    for name, joint in ends.items():
        siblings.setdefault(_link(joint, "parent"), {})[name] = set()
    is_late = False
    for follower in followers:
        own, leader = (_way(name, ends, above) for name in (follower.name, follower.leader))
        if own == leader[: len(own)]:
            words = f"joint {follower.name!r} mimics {follower.leader!r}, which moves with it"
            raise RobotFileError(
                path, f"{words}: exchange leader and follower, or load it with mimic = false"
            )
        if leader != own[: len(leader)]:
            after, before = next((a, b) for a, b in zip(own, leader, strict=False) if a != b)
            siblings[_link(ends[after], "parent")][after].add(before)
            is_late |= before > after
    return {
        name: f"{place:06d}{name}"
        for group in (siblings.values() if is_late else ())
        for place, name in enumerate(_in_order(path, group))
    }


def with_names(root: ElementTree.Element, names: Mapping[str, str]) -> str:
    """Text of a URDF whose joints have other names; `root` is changed."""
    for element in root.iter():
        key = {"joint": "name", "mimic": "joint"}.get(str(element.tag))
        if key is not None and element.get(key) in names:
            element.set(key, names[element.get(key, "")])
    return ElementTree.tostring(root, encoding="unicode")


def give_back(model: pin.Model, names: Mapping[str, str]) -> None:
    """Give the joints of a model, and their frames, their own names."""
    own = {other: name for name, other in names.items()}
    for number, name in enumerate(model.names):
        model.names[number] = own.get(name, name)
    for frame in model.frames:
        frame.name = own.get(frame.name, frame.name)


def _link(joint: ElementTree.Element, end: str) -> str:
    found = joint.find(end)
    return "" if found is None else found.get("link", "")


def _way(name: str, ends: Mapping[str, ElementTree.Element], above: Mapping[str, str]) -> list[str]:
    """Joints from the root of the tree to one."""
    way = [name]
    while (link := _link(ends[way[0]], "parent")) in above:
        way.insert(0, above[link])
    return way


def _in_order(path: Path, after: Mapping[str, Iterable[str]]) -> list[str]:
    """Joints of a link by name, but each after those that it waits for."""
    sorter, order = TopologicalSorter(after), list[str]()
    try:
        sorter.prepare()
    except CycleError as error:
        words = " and ".join(repr(name) for name in dict.fromkeys(error.args[1]))
        raise RobotFileError(
            path,
            f"joints beyond {words} mimic each other's: make one the leader of all, or load it with mimic = "
            "false",
        ) from error
    ready = set[str]()
    while sorter.is_active():
        ready |= set(sorter.get_ready())
        order.append(min(ready))
        ready.remove(order[-1])
        sorter.done(order[-1])
    return order
