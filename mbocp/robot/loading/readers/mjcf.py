"""Reading an MJCF, MuJoCo's format: bodies, joints, motors, loops and a pose; what is left out is told."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._text import show
from mbocp.exceptions import RobotFileError, suggest
from mbocp.robot.kinematics import WORLD
from mbocp.robot.loading.description import ROOT_JOINT, Description, Oddity, ReadOptions
from mbocp.robot.loading.readers.mjcf_bodies import Bodies, read_bodies
from mbocp.robot.loading.readers.mjcf_geoms import mesh_assets
from mbocp.robot.loading.readers.mjcf_tendons import read_fixed_tendons
from mbocp.robot.loading.readers.mjcf_xml import ACTUATORS, Mjcf, XmlElement, find_named_joint, parse_mjcf
from mbocp.robot.loading.readers.tree import TreeJoint, describe_tree, oddities_of, placements_of
from mbocp.robot.loading.robot_toml import RobotTable, tables_from

_HOME = "home"  # name of the pose to begin in
_TOLERANCE = 1e-9  # for force and moment that are parallel
_NUMBERS = {"free": 7, "ball": 4}  # of qpos


def read(path: Path, name: str, how: ReadOptions) -> Description:
    """Read a robot from an MJCF; it has no mimic joints, but couplings, whatever `mimic` is."""
    mjcf = parse_mjcf(path)
    found = read_bodies(mjcf, how.folders)
    table = read_tables(mjcf, found, how.free_flyer)
    disabled = partial(read_disabled_pairs, mjcf)
    return describe_tree(path, mjcf.name, found.bodies, table, found.left_out, how, disabled)


def companions(path: Path) -> tuple[Path, ...]:
    """The files that it includes."""
    return parse_mjcf(path).includes


def addresses(path: Path) -> tuple[str, ...]:
    """Addresses of its meshes."""
    meshes = mesh_assets(parse_mjcf(path)).values()
    return tuple(dict.fromkeys(mesh.address for mesh in meshes if mesh.triangles is None))


def oddities(path: Path) -> Iterator[Oddity]:
    """Joints that cannot move: MuJoCo refuses most of what else is odd."""
    return oddities_of(read_bodies(parse_mjcf(path), ()).bodies)


def read_tables(mjcf: Mjcf, found: Bodies, free_flyer: bool | None) -> RobotTable:
    """Motors, loops, initial pose and gravity, as the tables of a robot.toml; limits go to the joints.

    Raises
    ------
    RobotFileError
        For names that there are not.
    """
    reader = _Tables(mjcf, found, {joint.name: joint for joint in found.joints})
    told: dict[str, Any] = {"constraint": []}
    reader.equalities(told)
    reader.motors(told)
    reader.pose(told, free_flyer)
    reader.options(told)
    for tag in ("deformable", "extension"):
        for element in mjcf.each(tag):
            found.left_out.add(f"<{tag}>", element.get("name", element.tag))
    return tables_from({key: value for key, value in told.items() if value})


def read_disabled_pairs(mjcf: Mjcf) -> frozenset[frozenset[str]]:
    """Pairs of bodies of <exclude>."""
    excluded = mjcf.root.iterfind("contact/exclude")
    return frozenset(frozenset((e.get("body1", ""), e.get("body2", ""))) for e in excluded)


@dataclass
class _Tables:
    mjcf: Mjcf
    found: Bodies
    joints: Mapping[str, TreeJoint]

    def motors(self, told: dict[str, Any]) -> None:
        """Motors of joints and fixed tendons, thrusters on sites; without any, what the defaults say."""
        limits: dict[str, Array] = {}
        pulls: dict[str, Array] = {}
        tendons = read_fixed_tendons(self.mjcf, self.joints, self.found.left_out)
        thrusters: list[dict[str, Any]] = []
        elements = list(self.mjcf.each("actuator"))
        for element in elements:
            node = self.mjcf.node(element)
            joint = self.joints.get(node.text("joint", node.text("jointinparent")))
            tendon, gear = node.text("tendon"), node.number("gear", 1.0)
            turns = gear != 0.0 and element.tag in ACTUATORS and element.tag != "damper"  # which only brakes
            if turns and joint is not None and joint.held is None and joint.has_axis:
                limits[joint.name] = limits.get(joint.name, 0.0) + np.sort(gear * _force_range(node))
            elif turns and tendon in tendons:
                pulls[tendon] = pulls.get(tendon, 0.0) + np.sort(gear * _force_range(node))
            elif (thruster := self._thruster(node)) is not None:
                thrusters.append(thruster)
            else:
                self.found.left_out.add("actuators", f"{node.text('name', element.tag)}{self._why(node)}")
        pulled = dict.fromkeys(joint for tendon in pulls for joint in tendons[tendon]["joints"])
        for name in (name for name in pulled if math.isfinite(self.joints[name].effort)):
            self.found.left_out.add("actuatorfrcrange of joints on tendons", name)
        for name, sides in limits.items():
            joint = self.joints[name]
            joint.effort_lower, joint.effort = np.clip(sides, joint.effort_lower, joint.effort).tolist()
        if elements:
            told["actuation"] = {"joints": list(limits)}
            told["actuator"] = [*(tendons[name] | _effort(*pulls[name]) for name in pulls), *thrusters]

    def _why(self, node: XmlElement) -> str:
        for key in ("tendon", "body", "site", "cranksite", "joint", "jointinparent"):
            if key in node.said:
                return f" (on {key} {node.text(key)})"
        return ""

    def _thruster(self, node: XmlElement) -> dict[str, Any] | None:
        """A thrust on a site, if its moment is about the same axis."""
        site = node.text("site")
        if not site or "refsite" in node.said:
            return None
        gear = node.vector("gear", (1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        force, moment = gear[:3], gear[3:]
        size = float(np.linalg.norm(force))
        if size == 0.0 or np.linalg.norm(np.cross(force, moment)) > _TOLERANCE * size:
            return None
        return {
            "type": "thruster",
            "frame": self.found.frame_of(site),
            "name": node.text("name", site),
            "axis": (force / size).tolist(),
            "torque_ratio": float(force @ moment) / size**2,
            **_effort(*_force_range(node) * size),
        }

    def equalities(self, told: dict[str, Any]) -> None:
        """Loops, couplings and locked joints."""
        made: Mapping[str, Callable[[XmlElement, str], dict[str, Any] | None]] = {
            "connect": self._connect,
            "weld": self._weld,
        }
        mocap = self.mjcf.root.iterfind(".//body[@mocap='true']")
        dragged = {part.get("name") for body in mocap for part in body.iter() if part.tag in ("body", "site")}
        for number, element in enumerate(self.mjcf.each("equality")):
            node = self.mjcf.node(element)
            if node.text("active", "true") == "false":
                continue
            name = node.text("name") or f"{element.tag}_{number}"
            if dragged & {node.text(key) for key in ("body1", "body2", "site1", "site2")}:
                self.found.left_out.add("what holds on to mocap bodies, which others move", name)
            elif element.tag in made:
                told["constraint"].append(made[element.tag](node, name))
            elif element.tag == "joint":
                self._couple(node, name, told["constraint"])
            else:
                self.found.left_out.add(f"equality of {element.tag}s", name)

    def _couple(self, node: XmlElement, name: str, rows: list[dict[str, Any]]) -> None:
        """Joint 1 as a polynomial of joint 2, both from their references; what is linear is a coupling."""
        first, second = node.text("joint1"), node.text("joint2")
        named = [find_named_joint(node, key, self.joints) for key in ("joint1", "joint2")[: 1 + bool(second)]]
        c = node.vector("polycoef", (0.0, 1.0, 0.0, 0.0, 0.0))
        start = self.joints[first].reference + c[0]
        is_fixed = not second or not np.any(c[1:])
        if any(not joint.has_axis for joint in named) or (not is_fixed and np.any(c[2:])):
            self.found.left_out.add("equality of joints that is not linear", name)
        elif is_fixed:
            self.joints[first].held = float(start)
        else:
            offset = float(start - c[1] * self.joints[second].reference)
            row = {"type": "coupling", "name": name, "joints": (first, second)}
            rows.append({**row, "ratio": float(c[1]), "offset": offset})

    def _connect(self, node: XmlElement, name: str) -> dict[str, Any]:
        if "site1" in node.said:
            return {"type": "point", "name": name, "frames": self._sites(node)}
        a, b, relative = self._pair(node)
        anchor = node.three("anchor")
        return {
            "type": "point",
            "name": name,
            "frames": (a, b),
            "position": anchor.tolist(),
            "position_b": relative.actInv(anchor).tolist(),
        }

    def _weld(self, node: XmlElement, name: str) -> dict[str, Any]:
        if "site1" in node.said:
            return {"type": "weld", "name": name, "frames": self._sites(node)}
        a, b, relative = self._pair(node)
        pose = node.vector("relpose", (0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        if np.any(pose[3:]):
            w, x, y, z = pose[3:] / np.linalg.norm(pose[3:])
            relative = pin.SE3(pin.Quaternion(w, x, y, z).matrix(), pose[:3])
        turn = pin.Quaternion(relative.rotation).coeffs().tolist()
        row = {"type": "weld", "name": name, "frames": (a, b)}
        return {**row, "position": relative.translation.tolist(), "orientation": turn}

    def _sites(self, node: XmlElement) -> tuple[str, str]:
        return self.found.frame_of(node.text("site1")), self.found.frame_of(node.text("site2"))

    def _pair(self, node: XmlElement) -> tuple[str, str, pin.SE3]:
        """Names of two bodies, and where the second is in the first as the file places them."""
        placed = placements_of(self.found.bodies)
        names = [node.text(key) or WORLD for key in ("body1", "body2")]
        for name in names:
            if name not in placed:
                words = f"there is no body {show(name)}: {suggest(name, list(placed))}"
                raise RobotFileError(node.path, f"{node.where}: {words}")
        return names[0], names[1], placed[names[0]].actInv(placed[names[1]])

    def pose(self, told: dict[str, Any], free_flyer: bool | None) -> None:
        """The keyframe that is called home."""
        element = next((e for e in self.mjcf.root.iterfind("keyframe/key") if e.get("name") == _HOME), None)
        if element is None or "qpos" not in element.attrib:
            return
        node = self.mjcf.node(element)
        values, count = node.vector("qpos", None), sum(_NUMBERS.get(j.kind, 1) for j in self.found.joints)
        if len(values) != count:
            words = f"qpos has {len(values)} numbers, but the joints have {count}"
            raise RobotFileError(node.path, f"{node.where}: {words}")
        pose: dict[str, Any] = {}
        floating = [joint for joint in self.found.joints if joint.kind == "free"]
        for joint in self.found.joints:
            own, values = np.split(values, [_NUMBERS.get(joint.kind, 1)])
            if joint.kind in _NUMBERS:
                own = np.concatenate([own[:-4], np.roll(own[-4:], -1)])  # quaternions: w is the first in qpos
            if joint.held is not None:
                continue
            if joint.kind != "free":
                pose[joint.name] = own.tolist() if len(own) > 1 else float(own[0])
            elif free_flyer is not False:
                pose[ROOT_JOINT if len(floating) == 1 else joint.name] = own.tolist()
        told["initial"] = {"q": pose} if pose else None

    def options(self, told: dict[str, Any]) -> None:
        """Gravity; a fluid is told."""
        for element in self.mjcf.root.iterfind("option"):
            node = self.mjcf.node(element)
            if "gravity" in node.said:
                told["gravity"] = node.three("gravity").tolist()
            for key in ("density", "viscosity"):
                if node.number(key, 0.0):
                    self.found.left_out.add("the fluid around the robot", key)
            flag = element.find("flag")
            if flag is not None and flag.get("gravity") == "disable":
                told["gravity"] = [0.0, 0.0, 0.0]


def _effort(lower: float, upper: float) -> dict[str, list[float]]:
    """Limits of an actuator, unless one is infinite."""
    return {"effort": [float(lower), float(upper)]} if math.isfinite(upper - lower) else {}


def _force_range(node: XmlElement) -> Array:
    """Least and largest force of an actuator before its gear, shape (2,); infinite without bounds."""
    is_motor = node.tag == "motor" or (
        node.tag == "general" and all(node.text(key, "none") == "none" for key in ("biastype", "dyntype"))
    )
    gain = 1.0 if node.tag == "motor" else node.number("gainprm", 1.0)
    lower, upper = node.range("force")
    if is_motor and gain:
        least, largest = np.sort(gain * node.range("ctrl"))
        lower, upper = max(lower, least), min(upper, largest)
    return np.array([lower, upper])
