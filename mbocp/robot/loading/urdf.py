"""Reading a URDF: checks with names before Pinocchio sees it, then the `pin.Model`."""

from __future__ import annotations

import contextlib
import math
import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from mbocp._files import MEGABYTE, read_text
from mbocp.exceptions import RobotFileError, Unreadable
from mbocp.robot.loading.mimic import Follower, followers, with_first_leaders
from mbocp.robot.loading.not_modelled import tell_not_modelled
from mbocp.robot.loading.urdf_inertia import read_inertials, tell_impossible_inertias, total_mass
from mbocp.robot.loading.urdf_losses import check_losses
from mbocp.robot.loading.urdf_tree import check_tree

ROOT_JOINT = "root_joint"
_FOREIGN_ROOTS = {"sdf": "an SDF file", "mujoco": "a MuJoCo model", "COLLADA": "a Collada mesh"}
_MAX_BYTES = 16 * MEGABYTE  # of a URDF [bytes]; the largest that we know has 0.4 MB
_MAX_LEVELS = 100  # of elements within each other; a URDF needs six
_MASS_TOLERANCE = 1e-9  # relative
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
        If it has a joint type that is not supported, a negative or NaN mass, moment of inertia, damping or
        friction.
    """
    urdf = _parse(path)
    check_tree(path, urdf.root)
    read_inertials(path, urdf.root)
    check_losses(path, urdf.root)
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
    model = _pinocchio_model(urdf, free_flyer=free_flyer, mimic=mimic)
    _check_mass(urdf, model)
    tell_impossible_inertias(urdf.path, urdf.root, model)
    tell_not_modelled(urdf.path, urdf.root)
    return model


def _pinocchio_model(urdf: Urdf, *, free_flyer: bool, mimic: bool) -> pin.Model:
    text = urdf.text
    if mimic:
        found = followers(urdf.path, urdf.root)
        text = with_first_leaders(text, urdf.root, found)
        if found:
            _refuse_late_leaders(urdf, found, free_flyer)
    noise: list[str] = []
    try:
        with captured_stderr(noise):
            if free_flyer:
                return pin.buildModelFromXML(text, pin.JointModelFreeFlyer(), ROOT_JOINT, mimic)
            return pin.buildModelFromXML(text, mimic)
    except Exception as error:  # any exception of Pinocchio or urdfdom
        lines = [*"".join(noise).split("\n"), str(error).rpartition("message:")[2]]
        said = " ".join(" ".join(dict.fromkeys(lines)).split())
        hint = "; mimic = false makes them joints of their own" if mimic and "imic" in said else ""
        raise RobotFileError(urdf.path, f"Pinocchio cannot read this URDF: {said}{hint}") from error


def _refuse_late_leaders(urdf: Urdf, found: Sequence[Follower], free_flyer: bool) -> None:
    """Refuse by name a leader that comes after its follower, which Pinocchio cannot build."""
    names = list(_pinocchio_model(urdf, free_flyer=free_flyer, mimic=False).names)
    for follower in found:
        if names.index(follower.leader) > names.index(follower.name):
            raise RobotFileError(
                urdf.path,
                f"joint {follower.name!r} mimics {follower.leader!r}, which comes after it in the model "
                "(depth first, and by name where a link has several joints): exchange leader and follower, "
                "or their names, or load the robot with mimic = false",
            )


@contextlib.contextmanager
def captured_stderr(into: list[str]) -> Iterator[None]:
    """Catch what C++ libraries write to stderr, for use in a message."""
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
    if not os.path.lexists(path):
        raise RobotFileError(path, "no such URDF file")
    try:
        text = read_text(path, expected="a URDF", limit=_MAX_BYTES)
    except Unreadable as error:
        raise RobotFileError(path, error.reason) from error
    text = _declared_first(text)
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise RobotFileError(path, f"malformed XML: {error}") from error
    _check_depth(path, root)
    if root.tag != "robot":
        what = _FOREIGN_ROOTS.get(root.tag, f"XML with the root element <{root.tag}>")
        raise RobotFileError(path, f"not a URDF: it is {what}, expected the root element <robot>")
    if any("xacro" in element.tag for element in root.iter()):
        raise RobotFileError(
            path, "has xacro macros in it: expand them first (`xacro in.urdf.xacro > out.urdf`)"
        )
    return Urdf(path, text, root)


def _declared_first(text: str) -> str:
    """Put blank lines before an XML declaration behind it, where they may be; lines keep their numbers."""
    rest = text.lstrip()
    declaration, end, behind = rest.partition("?>")
    if rest == text or not rest.startswith("<?xml") or not end:
        return text
    return declaration + end + text[: len(text) - len(rest)] + behind


def _check_depth(path: Path, root: ElementTree.Element) -> None:
    level, depth = [root], 0
    while level:
        level, depth = [inner for element in level for inner in element], depth + 1
        if depth > _MAX_LEVELS:
            raise RobotFileError(path, f"XML elements are nested more than {_MAX_LEVELS} deep")


def _check_mass(urdf: Urdf, model: pin.Model) -> None:
    """Nothing that has mass is lost between the file and the model."""
    found, written = (
        math.fsum(i.mass for i in model.inertias),
        total_mass(read_inertials(urdf.path, urdf.root)),
    )
    if not abs(found - written) <= _MASS_TOLERANCE * written:
        raise RobotFileError(
            urdf.path, f"its links weigh {written:g} kg, but Pinocchio reads {found:g} kg of them"
        )
