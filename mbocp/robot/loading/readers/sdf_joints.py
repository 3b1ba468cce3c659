"""Joints of an SDF: a tree of bodies, and constraints where joints close loops."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import field
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbocp._arrays import dataclass
from mbocp._text import show
from mbocp.exceptions import RobotFileError, UnsupportedRobot
from mbocp.robot.kinematics import WORLD
from mbocp.robot.loading.description import ROOT_JOINT
from mbocp.robot.loading.readers.sdf_xml import Sdf, is_static
from mbocp.robot.loading.readers.tree import LeftOut, TreeBody, TreeJoint

_KINDS = ("revolute", "continuous", "prismatic", "ball", "universal", "revolute2", "fixed")
_TWO_AXES = ("universal", "revolute2")
_CLOSED_BY = {"fixed": "weld", "ball": "point", "revolute": "hinge", "continuous": "hinge"}


class Joint(NamedTuple):
    """A joint as it is written.

    Attributes
    ----------
    name, kind : str
    parent, child : str
        Links, or the world.
    placement : pin.SE3
        In the model.
    element : Element
    """

    name: str
    kind: str
    parent: str
    child: str
    placement: pin.SE3
    element: ElementTree.Element

    @property
    def where(self) -> str:
        """What it is called in messages."""
        return f"joint {show(self.name)}"


@dataclass
class BodyTables:
    """Bodies of the tree, parents before children, and tables of a robot.toml."""

    bodies: list[TreeBody] = field(default_factory=list)
    loops: list[dict[str, Any]] = field(default_factory=list)
    couplings: list[dict[str, Any]] = field(default_factory=list)


def read_joints(sdf: Sdf, links: Mapping[str, TreeBody], left_out: LeftOut) -> BodyTables:
    """Hang the links on each other.

    Parameters
    ----------
    sdf : Sdf
    links : mapping
        Bodies placed in the model; they are placed in their parents.
    left_out : LeftOut
        Takes what is not modelled.

    Raises
    ------
    RobotFileError, UnsupportedRobot
        Naming the joint.
    """
    reader = _Reader(sdf, links, left_out)
    joints = [reader.joint(element) for element in sdf.element.iterfind("joint")]
    tree, closing = _split(joints, links)
    at = {name: body.placement for name, body in links.items()}
    base = sdf.pose(sdf.element, f"model {show(sdf.name)}")
    frame = sdf.element.get("placement_frame")
    base = base * sdf.place(frame).inverse() if frame else base
    found = BodyTables()
    for name, joint in _in_order(tree, list(links)):
        reader.hang(found, name, joint, at, base)
    for joint in closing:
        found.loops.append(reader.close(joint, at, base))
    for joint in joints:
        found.couplings += reader.couplings(joint)
    return found


@dataclass(frozen=True)
class _Reader:
    sdf: Sdf
    links: Mapping[str, TreeBody]
    left_out: LeftOut

    def joint(self, element: ElementTree.Element) -> Joint:
        """A joint, checked."""
        sdf, name, kind = self.sdf, element.get("name", ""), element.get("type", "")
        where = f"{sdf.path}: joint {show(name)}"
        if kind not in _KINDS:
            raise UnsupportedRobot(f"{where} is of type {show(kind)}; supported: {', '.join(_KINDS)}")
        parent, child = (sdf.link_of((element.findtext(end) or "").strip()) for end in ("parent", "child"))
        if parent == child:
            raise RobotFileError(sdf.path, f"joint {show(name)} joins link {show(child)} to itself")
        return Joint(name, kind, parent, child, sdf.place(name), element)

    def hang(
        self, found: BodyTables, name: str, joint: Joint | None, at: Mapping[str, pin.SE3], base: pin.SE3
    ) -> None:
        """Put a link into the tree, on the joint that leads to it; None: it floats."""
        body = self.links[name]
        if joint is None:
            body.placement = base * at[name]
            is_fixed = is_static(self.sdf.element)
            body.joints = [] if is_fixed else [TreeJoint(f"{name}_{ROOT_JOINT}", "free")]
        else:
            parent = joint.parent if joint.child == name else joint.child
            body.parent = None if parent == WORLD else parent
            body.placement = (base if parent == WORLD else at[parent].inverse()) * at[name]
            body.joints = list(
                self._tree_joints(joint, at[name].actInv(joint.placement), joint.child == name)
            )
        found.bodies.append(body)

    def _tree_joints(self, joint: Joint, anchor: pin.SE3, is_forward: bool) -> Iterator[TreeJoint]:
        """The joints of a model that a joint of the file is; placed in the body, in its axes."""
        if joint.kind == "fixed":
            return
        place = pin.SE3(np.eye(3), anchor.translation)
        if joint.kind == "ball":
            yield TreeJoint(joint.name, "ball", anchor=place)
            return
        tags = ["axis", "axis2"] if joint.kind in _TWO_AXES else ["axis"]
        names = [joint.name] if len(tags) == 1 else [f"{joint.name}_1", f"{joint.name}_2"]
        made = [self._single(joint, tag, name, anchor, place) for tag, name in zip(tags, names, strict=True)]
        for each in made if is_forward else reversed(made):
            each.axis = each.axis if is_forward else -each.axis
            yield each

    def _single(self, joint: Joint, tag: str, name: str, anchor: pin.SE3, place: pin.SE3) -> TreeJoint:
        """A joint about or along one axis; one without end is revolute without limits."""
        sdf, where = self.sdf, joint.where
        kind = "prismatic" if joint.kind == "prismatic" else "revolute"
        made = TreeJoint(name, kind, anchor.rotation @ sdf.axis(joint.element, tag, where), place)
        axis = joint.element.find(tag)
        limit = None if axis is None else axis.find("limit")
        if limit is not None:
            if joint.kind != "continuous":
                made.lower = sdf.limit(limit, "lower", where, -math.inf)
                made.upper = sdf.limit(limit, "upper", where, math.inf)
            for key in ("velocity", "effort"):
                value = sdf.limit(limit, key, where, -1.0)
                setattr(made, key, value if value >= 0.0 else math.inf)
        dynamics = None if axis is None else axis.find("dynamics")
        if dynamics is not None:
            made.damping, made.friction = (
                sdf.number(dynamics, key, where, 0.0) for key in ("damping", "friction")
            )
            if sdf.number(dynamics, "spring_stiffness", where, 0.0):
                self.left_out.add("springs of joints", joint.name)
        return made

    def close(self, joint: Joint, at: Mapping[str, pin.SE3], base: pin.SE3) -> dict[str, Any]:
        """The constraint that a joint is where it closes a loop."""
        if joint.kind not in _CLOSED_BY:
            kinds = ", ".join(_CLOSED_BY)
            words = f"closes a loop and is {joint.kind}; those that close loops are {kinds}"
            raise UnsupportedRobot(f"{self.sdf.path}: {joint.where} {words}")
        told: dict[str, Any] = {"type": _CLOSED_BY[joint.kind], "name": joint.name}
        places = [
            base * joint.placement if link == WORLD else at[link].actInv(joint.placement)
            for link in (joint.parent, joint.child)
        ]
        told["frames"] = (joint.parent, joint.child)
        for suffix, place in zip(("", "_b"), places, strict=True):
            told[f"position{suffix}"] = place.translation.tolist()
            told[f"orientation{suffix}"] = pin.Quaternion(place.rotation).coeffs().tolist()
        if told["type"] == "hinge":
            told["axis"] = tuple(self.sdf.axis(joint.element, "axis", joint.where).tolist())
        return told

    def couplings(self, joint: Joint) -> Iterator[dict[str, Any]]:
        """What <mimic> says."""
        mimic = joint.element.find("axis/mimic")
        if mimic is None:
            return
        leader, where = mimic.get("joint", ""), f"{joint.where}: mimic"
        if leader not in self.sdf.elements or self.sdf.elements[leader].tag != "joint":
            raise RobotFileError(self.sdf.path, f"{where}: there is no joint {show(leader)}")
        numbers = ("multiplier", "offset", "reference")
        ratio, offset, reference = (self.sdf.number(mimic, key, where, 0.0) for key in numbers)
        row = {"type": "coupling", "name": f"{joint.name}_mimic", "joints": (joint.name, leader)}
        yield {**row, "ratio": ratio, "offset": offset - ratio * reference}


def _split(joints: list[Joint], links: Mapping[str, TreeBody]) -> tuple[dict[str, list[Joint]], list[Joint]]:
    """Joints of a tree by the links that they touch, and those that close loops, ball joints first."""
    group = {name: name for name in (*links, WORLD)}

    def top(name: str) -> str:
        while group[name] != name:
            name = group[name]
        return name

    tree: dict[str, list[Joint]] = {name: [] for name in group}
    closing: list[Joint] = []
    for joint in sorted(joints, key=lambda joint: joint.kind == "ball"):
        a, b = top(joint.parent), top(joint.child)
        if a == b:
            closing.append(joint)
            continue
        group[b] = a
        tree[joint.parent].append(joint)
        tree[joint.child].append(joint)
    return tree, closing


def _in_order(tree: Mapping[str, list[Joint]], links: list[str]) -> Iterator[tuple[str, Joint | None]]:
    """Links with the joints that lead to them, depth first, in the order of the file; roots float."""
    children = {joint.child for joints in tree.values() for joint in joints}
    reached: set[str] = set()
    roots = [WORLD, *(link for link in links if link not in children), *links]
    for root in roots:
        stack: list[tuple[str, Joint | None]] = [(root, None)]
        while stack:
            name, joint = stack.pop()
            if name in reached:
                continue
            reached.add(name)
            if name != WORLD:
                yield name, joint
            ends = [(j.child if j.parent == name else j.parent, j) for j in tree[name]]
            stack += [end for end in reversed(ends) if end[0] not in reached]
