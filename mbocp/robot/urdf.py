"""Reading a URDF: checks with names before Pinocchio sees it, then the `pin.Model`."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbocp.exceptions import RobotFileError, UnsupportedRobot

__all__ = ["Urdf", "build_model", "read_urdf"]

ROOT_JOINT = "root_joint"
_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_MIMIC_TYPES = ("revolute", "continuous", "prismatic")
_FOREIGN_ROOTS = {"sdf": "an SDF file", "mujoco": "a MuJoCo model", "COLLADA": "a Collada mesh"}
_ROUND_OFF = 1e-9  # [kg m^2]; exporters print a zero moment of inertia as a tiny negative number
_INERTIA_KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_stderr_lock = threading.Lock()


@dataclass(frozen=True)
class Urdf:
    """A URDF that has passed the checks: path, text and element tree."""

    path: Path
    text: str
    root: ElementTree.Element

    @property
    def name(self) -> str:
        """The name that the URDF gives the robot."""
        return self.root.get("name") or self.path.stem


def read_urdf(path: Path) -> Urdf:
    """Read and check a URDF.

    Raises
    ------
    RobotFileError
        If it is missing, malformed, or no tree of links and joints.
    UnsupportedRobot
        If it has a joint type that is not supported, a negative or NaN mass or moment of inertia.
    """
    urdf = _parse(path)
    _check_tree(urdf)
    for link in urdf.root.iterfind("link"):
        _check_inertial(urdf, link)
    return urdf


def build_model(urdf: Urdf, *, free_flyer: bool, mimic: bool) -> pin.Model:
    """Let Pinocchio build the model.

    Parameters
    ----------
    urdf : Urdf
        What `read_urdf` returned.
    free_flyer : bool
        Put a free-flyer called "root_joint" under the root link.
    mimic : bool
        Couple mimic joints to the joint they follow; otherwise they are joints of their own.
    """
    if mimic:
        _check_mimic(urdf)
    noise: list[str] = []
    try:
        with captured_stderr(noise):
            if free_flyer:
                return pin.buildModelFromXML(urdf.text, pin.JointModelFreeFlyer(), ROOT_JOINT, mimic)
            return pin.buildModelFromXML(urdf.text, mimic)
    except Exception as error:  # whatever Pinocchio and urdfdom throw across the language border
        lines = [*"".join(noise).split("\n"), str(error).rpartition("message:")[2]]
        said = " ".join(" ".join(dict.fromkeys(lines)).split())
        hint = "; mimic = false makes them joints of their own" if mimic and "imic" in said else ""
        raise RobotFileError(urdf.path, f"Pinocchio cannot read this URDF: {said}{hint}") from error


@contextlib.contextmanager
def captured_stderr(into: list[str]) -> Iterator[None]:
    """Catch what C++ libraries write to stderr, so that it can be told in context."""
    with _stderr_lock, tempfile.TemporaryFile() as file:
        sys.stderr.flush()
        saved = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            file.seek(0)
            into.append(file.read().decode(errors="replace"))


def _parse(path: Path) -> Urdf:
    if not path.exists():
        raise RobotFileError(path, "no such URDF file")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RobotFileError(path, f"cannot be read: {error}") from error
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise RobotFileError(path, f"malformed XML: {error}") from error
    if root.tag != "robot":
        what = _FOREIGN_ROOTS.get(root.tag, f"XML with the root element <{root.tag}>")
        raise RobotFileError(path, f"not a URDF: it is {what}, expected the root element <robot>")
    if any("xacro" in element.tag for element in root.iter()):
        raise RobotFileError(
            path, "has xacro macros in it: expand them first (`xacro in.urdf.xacro > out.urdf`)"
        )
    return Urdf(path, text, root)


def _check_tree(urdf: Urdf) -> None:
    links = [_name(urdf, link) for link in urdf.root.iterfind("link")]
    elements = list(urdf.root.iterfind("joint"))
    names = [_name(urdf, joint) for joint in elements]
    for kind, found in (("link", links), ("joint", names)):
        repeated = [name for name, count in Counter(found).items() if count > 1]
        if repeated:
            raise RobotFileError(urdf.path, f"{kind} {repeated[0]!r} is defined more than once")
    if not links:
        raise RobotFileError(urdf.path, "has no link")
    children: dict[str, str] = {}
    for name, joint in zip(names, elements, strict=True):
        _check_joint_type(urdf, name, joint.get("type"))
        for end in ("parent", "child"):
            link = _attribute(joint.find(end), "link")
            if link not in links:
                raise RobotFileError(urdf.path, f"joint {name!r}: its {end} link {link!r} is not defined")
        child = _attribute(joint.find("child"), "link") or ""
        if child in children:
            raise RobotFileError(
                urdf.path,
                f"link {child!r} is the child of two joints, {children[child]!r} and {name!r}: a URDF is a "
                "tree; close loops with [[constraint]] in a robot.toml",
            )
        children[child] = name
    roots = [link for link in links if link not in children]
    if len(roots) != 1:
        found_roots = ", ".join(repr(r) for r in roots) or "none"
        raise RobotFileError(
            urdf.path, f"must have exactly one root link (one that is no joint's child), has {found_roots}"
        )


def _check_joint_type(urdf: Urdf, name: str, kind: str | None) -> None:
    if kind not in _JOINT_TYPES:
        raise UnsupportedRobot(
            f"{urdf.path}: joint {name!r} is of type {kind!r}; supported: {', '.join(_JOINT_TYPES)} "
            "(and mimic on revolute, continuous and prismatic joints)"
        )


def _check_inertial(urdf: Urdf, link: ElementTree.Element) -> None:
    inertial = link.find("inertial")
    if inertial is None:
        return
    where = f"{urdf.path}: link {link.get('name')!r}"
    mass = _number(where, "mass", _attribute(inertial.find("mass"), "value"))
    if mass < 0:
        raise UnsupportedRobot(
            f"{where}: mass is {mass:g} kg; a mass must be positive (or zero: a massless link)"
        )
    element = inertial.find("inertia")
    values = {
        k: _number(where, k, _attribute(element, k) or ("0" if element is None else None))
        for k in _INERTIA_KEYS
    }
    for key in ("ixx", "iyy", "izz"):
        if values[key] < -_ROUND_OFF:
            raise UnsupportedRobot(
                f"{where}: {key} is {values[key]:g} kg m^2; a moment of inertia cannot be negative"
            )


def _check_mimic(urdf: Urdf) -> None:
    """Refuse by name what Pinocchio's mimic joints cannot follow."""
    joints = {joint.get("name"): joint for joint in urdf.root.iterfind("joint")}
    for name, joint in joints.items():
        mimic = joint.find("mimic")
        if mimic is None:
            continue
        leader = joints.get(mimic.get("joint"))
        where, who = f"{urdf.path}: joint {name!r} mimics", repr(mimic.get("joint"))
        remedy = "mend it, or load the robot with mimic = false"
        if leader is None:
            raise RobotFileError(urdf.path, f"joint {name!r} mimics {who}, which is not defined; {remedy}")
        if leader.find("mimic") is not None:
            raise UnsupportedRobot(f"{where} {who}, which itself mimics another joint; {remedy}")
        kinds = (joint.get("type"), leader.get("type"))
        if not set(kinds) <= set(_MIMIC_TYPES) or len({kind == "continuous" for kind in kinds}) > 1:
            raise UnsupportedRobot(
                f"{where} {who}: a {kinds[0]} joint cannot follow a {kinds[1]} one (continuous follows "
                f"continuous, revolute and prismatic follow each other); {remedy}"
            )


def _name(urdf: Urdf, element: ElementTree.Element) -> str:
    name = element.get("name")
    if not name:
        raise RobotFileError(urdf.path, f"a <{element.tag}> has no name")
    return name


def _attribute(element: ElementTree.Element | None, key: str) -> str | None:
    return None if element is None else element.get(key)


def _number(where: str, key: str, text: str | None) -> float:
    try:
        value = float(text) if text is not None else float("nan")
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise UnsupportedRobot(f"{where}: {key} is {text!r}, expected a finite number")
    return value
