"""Reading a URDF: checks with names before Pinocchio sees it, then the `pin.Model`, and mimic joints."""

from __future__ import annotations

import contextlib
import math
import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from mbocp._text import list_names
from mbocp.exceptions import RobotFileError, UnsupportedRobot
from mbocp.robot.loading.description import ROOT_JOINT, Description, Oddity, ReadOptions
from mbocp.robot.loading.joint_numbers import MimicJoint
from mbocp.robot.loading.readers.urdf_checks import check_losses, check_tree, find_oddities
from mbocp.robot.loading.readers.urdf_estimates import with_inertias
from mbocp.robot.loading.readers.urdf_extensions import read_loops, tell_omissions
from mbocp.robot.loading.readers.urdf_inertia import Inertial, read_inertials, tell_impossible_inertias
from mbocp.robot.loading.readers.urdf_order import give_back, make_sorted_names, with_names
from mbocp.robot.loading.readers.urdf_shapes import build_visuals, mesh_addresses, shapes_of
from mbocp.robot.loading.readers.urdf_xml import Urdf, find_srdf, finite_numbers, parse_urdf
from mbocp.robot.loading.robot_toml import RobotTable, tables_from

_MASS_TOLERANCE = 1e-9  # relative
_stderr_lock = threading.Lock()
_KINDS = ("revolute", "continuous", "prismatic")
_MAX_NAMES = 12  # in a message
_REMEDY = "mend it, or load the robot with mimic = false"


def read(path: Path, name: str, how: ReadOptions) -> Description:
    """Read a robot from a URDF; mimic joints follow their leaders unless told otherwise, see `Format`."""
    return describe_urdf(read_urdf(path), how)


def companions(path: Path) -> tuple[Path, ...]:
    """Files beside a URDF that belong to it: its SRDF."""
    srdf = find_srdf(path)
    return () if srdf is None else (srdf,)


def addresses(path: Path) -> tuple[str, ...]:
    """Addresses of the meshes of a URDF."""
    return mesh_addresses(read_urdf(path).root)


def oddities(path: Path) -> Iterator[Oddity]:
    """What is allowed in a URDF, and probably not meant."""
    return find_oddities(path, parse_urdf(path).root)


def read_urdf(path: Path) -> Urdf:
    """Parse and check a URDF.

    Raises
    ------
    RobotFileError
        If it is missing, malformed, or no tree of links and joints.
    UnsupportedRobot
        If it has a joint type that is not supported, a negative or NaN mass, moment of inertia, damping or
        friction.
    """
    return check_urdf(parse_urdf(path))


def check_urdf(urdf: Urdf) -> Urdf:
    """Check links, joints and numbers, as `read_urdf` does."""
    check_tree(urdf.path, urdf.root)
    read_inertials(urdf.path, urdf.root)
    check_losses(urdf.path, urdf.root)
    return urdf


def describe_urdf(urdf: Urdf, how: ReadOptions) -> Description:
    """Make the description of what a URDF says, which `read_urdf` returned."""
    urdf, estimated = (urdf, ()) if how.inertias is None else with_inertias(urdf, how.inertias, how.folders)
    mimic, loops = how.mimic is not False, read_loops(urdf.path, urdf.root)
    model = build_model(urdf, free_flyer=bool(how.free_flyer), mimic=mimic)
    return Description(
        name=urdf.name,
        file=urdf.path,
        model=model,
        visuals=build_visuals(urdf, model, how.folders),
        q0=pin.neutral(model),
        source=urdf.path,
        followers=followers(urdf.path, urdf.root) if mimic else (),
        shapes=(shapes_of(urdf, how.folders),),
        link_inertias=estimated,
        table=tables_from({"constraint": loops}) if loops else RobotTable.model_construct(),
    )


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
    inertials = read_inertials(urdf.path, urdf.root)
    _check_mass(urdf.path, model, inertials)
    tell_impossible_inertias(urdf.path, model, inertials)
    tell_omissions(urdf.path, urdf.root)
    return model


def _pinocchio_model(urdf: Urdf, *, free_flyer: bool, mimic: bool) -> pin.Model:
    text, names = urdf.text, dict[str, str]()
    if mimic:
        found = followers(urdf.path, urdf.root)
        text = with_first_leaders(text, urdf.root, found)
        names = make_sorted_names(urdf.path, urdf.root, found)
        text = with_names(ElementTree.fromstring(text), names) if names else text
    noise: list[str] = []
    try:
        with capture_stderr(noise):
            root = (pin.JointModelFreeFlyer(), ROOT_JOINT) if free_flyer else ()
            model = pin.buildModelFromXML(text, *root, mimic)
    except Exception as error:  # any exception of Pinocchio or urdfdom
        lines = [*"".join(noise).split("\n"), str(error).rpartition("message:")[2]]
        said = " ".join(" ".join(dict.fromkeys(lines)).split())
        hint = "; mimic = false makes them joints of their own" if mimic and "imic" in said else ""
        raise RobotFileError(urdf.path, f"Pinocchio cannot read this URDF: {said}{hint}") from error
    give_back(model, names)
    return model


@contextlib.contextmanager
def capture_stderr(into: list[str]) -> Iterator[None]:
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


def _check_mass(path: Path, model: pin.Model, inertials: Sequence[Inertial]) -> None:
    """Nothing that has mass is lost between the file and the model."""
    found = math.fsum(i.mass for i in model.inertias)
    written = math.fsum(inertial.mass for inertial in inertials)
    if not abs(found - written) <= _MASS_TOLERANCE * written:
        raise RobotFileError(
            path, f"its links weigh {written:g} kg, but Pinocchio reads {found:g} kg of them"
        )


def followers(path: Path, root: ElementTree.Element) -> tuple[MimicJoint, ...]:
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


def with_first_leaders(text: str, root: ElementTree.Element, found: Sequence[MimicJoint]) -> str:
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


def _resolve(path: Path, name: str, elements: Mapping[str, ElementTree.Element]) -> MimicJoint:
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
    return _add_limits(MimicJoint(name, at, multiplier, offset), path, elements[name])


def _add_limits(follower: MimicJoint, path: Path, element: ElementTree.Element) -> MimicJoint:
    """The follower with its limits and losses; zero or contradictory limits mean none."""
    who = f"joint {follower.name!r}"
    limit, dynamics = element.find("limit"), element.find("dynamics")
    lower, upper, velocity = (_number(path, who, limit, k, 0.0) for k in ("lower", "upper", "velocity"))
    damping, friction = (_number(path, who, dynamics, key, 0.0) for key in ("damping", "friction"))
    if lower == upper or element.get("type") == "continuous":
        lower, upper = -math.inf, math.inf
    lower, upper, velocity = min(lower, upper), max(lower, upper), velocity if velocity > 0.0 else math.inf
    return replace(follower, lower=lower, upper=upper, velocity=velocity, damping=damping, friction=friction)


def _check(path: Path, follower: MimicJoint, elements: Mapping[str, ElementTree.Element]) -> MimicJoint:
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
