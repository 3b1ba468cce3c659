"""A URDF with other inertias, damping and friction: the rest of its text stays as it is."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias
from xml.parsers import expat

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._files import read_text, root_tag
from mbocp._text import quote_all, warn_caller
from mbocp.exceptions import RobotFileError, Unreadable
from mbocp.identification.dynamics import PER_BODY, InverseDynamics
from mbocp.identification.unknown_parameters import OF_JOINT, Unknowns
from mbocp.robot.warnings import NotModelledWarning
from mbocp.solution.atomic import replace_file

_Change: TypeAlias = tuple[int, int, str]  # from, to [bytes], what to put there


@dataclass
class _Element:
    """Where an element stands in the text [bytes], and those that it has."""

    tag: str
    name: str
    start: int
    inside: int = 0
    end: int = 0
    parts: list[_Element] = field(default_factory=list)

    def all(self, tag: str) -> list[_Element]:
        return [part for part in self.parts if part.tag == tag]


def write_urdf(dynamics: InverseDynamics, unknowns: Unknowns, everything: Array, path: Path) -> Path:
    """Write the robot's URDF with other parameters.

    A link that others are fixed to gets the inertia of all, and they get none: no torque tells them apart.

    Raises
    ------
    RobotFileError
        If the robot is not read from one URDF, or a payload was found, which is no part of it.
    ResultFileError
        If it cannot be written.

    Warns
    -----
    NotModelledWarning
        For rotor inertias, and more than one friction speed, which a URDF cannot say.
    """
    robot, source = dynamics.robot, dynamics.robot.source
    if source is None or robot.parts or root_tag(source) != "robot":
        raise RobotFileError(
            source or path, f"robot {robot.name!r} is not read from a URDF: none can be written"
        )
    if any(body.name not in robot.joint_names for body in unknowns.bodies):
        raise RobotFileError(source, "a payload is no part of a URDF: write the numbers found as [[payload]]")
    try:
        text = read_text(source).encode()
        root = _parse(text)
    except (Unreadable, expat.ExpatError) as error:
        raise RobotFileError(source, f"cannot be read: {error}") from error
    changes = [
        *_inertias(dynamics, unknowns, everything, root, text),
        *_losses(dynamics, unknowns, everything, root, text),
    ]
    for start, end, new in sorted(changes, reverse=True):
        text = text[:start] + new.encode() + text[end:]
    return replace_file(path, text)


def _inertias(
    dynamics: InverseDynamics, unknowns: Unknowns, everything: Array, root: _Element, text: bytes
) -> Iterator[_Change]:
    robot, links = dynamics.robot, {link.name: link for link in root.all("link")}
    ends = {joint.name: _ends(joint, text) for joint in root.all("joint")}
    for body in unknowns.bodies:
        moved = [ends[body.name][1]]
        for link in moved:  # it grows: links that are fixed to those before
            fixed = (
                name for name, (parent, _) in ends.items() if parent == link and name not in robot.joint_names
            )
            moved += [ends[name][1] for name in fixed]
        own = everything[PER_BODY * (body.joint - 1) : PER_BODY * body.joint].copy()
        for payload in robot.payloads:
            frame = robot.model.frames[robot.frame_id(payload.frame)]
            if frame.parentJoint == body.joint:
                part = pin.Inertia(payload.mass, np.array(payload.com), payload.inertia_matrix)
                own -= frame.placement.act(part).toDynamicParameters()
        yield from _with_part(
            links[moved[0]], "inertial", _inertial(pin.Inertia.FromDynamicParameters(own)), text
        )
        for link in moved[1:]:
            yield from ((part.start, part.end, "") for part in links[link].all("inertial"))


def _losses(
    dynamics: InverseDynamics, unknowns: Unknowns, everything: Array, root: _Element, text: bytes
) -> Iterator[_Change]:
    robot, named = dynamics.robot, {joint.name: joint for joint in root.all("joint")}
    rotors, damping, friction = everything[PER_BODY * (robot.model.njoints - 1) :].reshape(3, robot.nv)
    for name in {
        label.name.removeprefix(OF_JOINT).rpartition(".")[0]
        for label in unknowns.labels[PER_BODY * len(unknowns.bodies) :]
    }:
        dof = robot.velocity_indices(name).start
        values = f'<dynamics damping="{damping[dof]:.9g}" friction="{friction[dof]:.9g}"/>'
        yield from _with_part(named[name], "dynamics", values, text)
    speeds = np.unique(dynamics.speeds[friction != 0.0])
    if len(speeds) > 1:
        warn_caller(
            "a URDF is read with one friction_speed: its joints have "
            + " and ".join(f"{speed:.4g}" for speed in speeds),
            NotModelledWarning,
        )
    turning = [name for name in dynamics.names if rotors[robot.velocity_indices(name).start]]
    if turning:
        warn_caller(
            f"a URDF has no rotor inertias: those of {quote_all(turning)} are left out", NotModelledWarning
        )


def _parse(text: bytes) -> _Element:
    parser = expat.ParserCreate()
    root = _Element("", "", 0)
    open_elements = [root]

    def begin(tag: str, attributes: dict[str, str]) -> None:
        at = parser.CurrentByteIndex
        element = _Element(tag, attributes.get("name", ""), at, _after_tag(text, at))
        open_elements[-1].parts.append(element)
        open_elements.append(element)

    def finish(_tag: str) -> None:
        element, at = open_elements.pop(), parser.CurrentByteIndex
        closes_itself = text[element.inside - 2 : element.inside] == b"/>"
        element.end = element.inside if closes_itself else _after_tag(text, at)

    parser.StartElementHandler, parser.EndElementHandler = begin, finish
    parser.Parse(text, True)
    return root.parts[0]


def _after_tag(text: bytes, start: int) -> int:
    """Behind the tag that begins there; attributes may hold ">" in quotes."""
    found = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""").match(text, start)
    assert found is not None, "expat has parsed it"
    return found.end()


def _ends(joint: _Element, text: bytes) -> tuple[str, str]:
    found = []
    for tag in ("parent", "child"):
        (part,) = joint.all(tag)
        name = re.search(rb"""link\s*=\s*["']([^"']*)["']""", text[part.start : part.inside])
        found.append(name[1].decode() if name else "")
    return found[0], found[1]


def _with_part(element: _Element, tag: str, new: str, text: bytes) -> list[_Change]:
    """Changes that put something in the place of an element's part, or at its begin where it has none."""
    parts = element.all(tag)
    if parts:
        return [(parts[0].start, parts[0].end, new), *((part.start, part.end, "") for part in parts[1:])]
    if text[element.inside - 2 : element.inside] == b"/>":
        return [(element.inside - 2, element.inside, f">{new}</{element.tag}>")]
    return [(element.inside, element.inside, new)]


def _inertial(body: pin.Inertia) -> str:
    xyz = " ".join(f"{x:.12g}" for x in body.lever)
    upper = zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), body.inertia[np.triu_indices(3)], strict=True)
    moments = " ".join(f'{name}="{moment:.12g}"' for name, moment in upper)
    return f'<inertial><origin xyz="{xyz}"/><mass value="{body.mass:.12g}"/><inertia {moments}/></inertial>'
