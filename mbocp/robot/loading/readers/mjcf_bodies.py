"""Bodies of an MJCF: placements, joints, inertias, shapes, sites."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._text import show
from mbocp.exceptions import RobotFileError, UnsupportedRobot
from mbocp.meshes.mesh_parts import scale_mass
from mbocp.robot.loading.readers.mjcf_geoms import (
    Geom,
    MeshAsset,
    inertia_of,
    materials_of,
    mesh_assets,
    read_geom,
    shape_of,
)
from mbocp.robot.loading.readers.mjcf_xml import Mjcf, XmlElement
from mbocp.robot.loading.readers.tree import ELLIPSOIDS, LeftOut, MissingMesh, TreeBody, TreeJoint

_KINDS = {"hinge": "revolute", "slide": "prismatic", "ball": "ball", "free": "free"}
_HOLDS = 1e6  # [N s/m, N m s/rad]: against such a damping a tonne sinks by a centimetre in a second
_MAKES_BODIES = ("composite", "flexcomp", "replicate", "attach", "plugin")
# Settings of <compiler> that change masses.
_OF_MASSES = {"boundmass": "0", "boundinertia": "0", "balanceinertia": "false"}


@dataclass
class Bodies:
    """What was read of the bodies.

    Attributes
    ----------
    bodies : list of TreeBody
        Parents before children.
    left_out : LeftOut
        What is not modelled.
    """

    bodies: list[TreeBody] = field(default_factory=list)
    left_out: LeftOut = field(default_factory=LeftOut)

    @property
    def joints(self) -> list[TreeJoint]:
        """In the order of MuJoCo's qpos."""
        return [joint for body in self.bodies for joint in body.joints]

    def frame_of(self, site: str) -> str:
        """The frame of a site: a body of its name would win."""
        return f"{site}_site" if any(body.name == site for body in self.bodies) else site


@dataclass
class _Reader:
    mjcf: Mjcf
    folders: Sequence[Path]
    meshes: Mapping[str, MeshAsset]
    colors: Mapping[str, Array]
    groups: tuple[float, float]
    found: Bodies = field(default_factory=Bodies)

    def children(
        self, element: ElementTree.Element, parent: str | None, inherited: str | None, frame: pin.SE3
    ) -> None:
        """Bodies below an element, in the order of the file; <frame> is a placement and no body."""
        for inner in element:
            if inner.tag in _MAKES_BODIES:
                where = f"{self.mjcf.path}: <{inner.tag}> {show(inner.get('name', ''))}"
                raise UnsupportedRobot(f"{where} is not supported; write the bodies that it makes")
            if inner.tag == "frame":
                placed = frame * self.mjcf.node(inner).placement
                self.children(inner, parent, inner.get("childclass", inherited), placed)
            elif inner.tag == "body":
                self.body(inner, parent, inner.get("childclass", inherited), frame)

    def body(
        self, element: ElementTree.Element, parent: str | None, inherited: str | None, frame: pin.SE3
    ) -> None:
        """One body and those below it."""
        node = self.mjcf.node(element)
        name = node.text("name") or f"body_{len(self.found.bodies) + 1}"
        body = TreeBody(name, parent, frame * node.placement)
        if node.number("gravcomp", 0.0):
            self.found.left_out.add("gravity compensation of bodies", name)
        self.found.bodies.append(body)
        geoms: list[Geom] = []
        self._inside(element, body, inherited, pin.SE3.Identity(), geoms)
        body.inertia = self._inertia(element, body, geoms)
        self.children(element, name, inherited, pin.SE3.Identity())

    def _inside(
        self,
        element: ElementTree.Element,
        body: TreeBody,
        inherited: str | None,
        frame: pin.SE3,
        geoms: list[Geom],
    ) -> None:
        """Joints, geoms and sites of a body, those in <frame> too."""
        for inner in element:
            if inner.tag == "frame":
                placed = frame * self.mjcf.node(inner).placement
                self._inside(inner, body, inner.get("childclass", inherited), placed, geoms)
                continue
            if inner.tag not in ("joint", "freejoint", "geom", "site"):
                continue
            node = self.mjcf.node(inner, inherited)
            if inner.tag == "site":
                if node.text("name"):
                    body.frames.append((node.text("name"), frame * node.placement))
            elif inner.tag == "geom":
                geom = read_geom(node, self.meshes, frame)
                if geom is not None:
                    geoms.append(geom)
                    self._shape(geom, body)
            else:
                self._joint(node, body, frame)

    def _shape(self, geom: Geom, body: TreeBody) -> None:
        if geom.kind == "ellipsoid":
            self.found.left_out.add(ELLIPSOIDS, body.name)
            return
        try:
            body.shapes.append(shape_of(geom, body.name, len(body.shapes), self.colors, self.folders))
        except FileNotFoundError as error:
            body.missing.append(MissingMesh(f"body {show(body.name)}", str(error), geom.is_solid))

    def _joint(self, node: XmlElement, body: TreeBody, frame: pin.SE3) -> None:
        word = "free" if node.tag == "freejoint" else node.text("type", "hinge")
        if word not in _KINDS:
            raise RobotFileError(node.path, f"{node.where}: unknown type {show(word)}")
        kind = _KINDS[word]
        name = node.text("name") or f"{body.name}_{word}" + (f"_{len(body.joints)}" if body.joints else "")
        axis = frame.rotation @ node.direction("axis", (0.0, 0.0, 1.0))
        anchor = pin.SE3(np.eye(3), frame.act(node.three("pos")))
        joint = TreeJoint(name, kind, axis, pin.SE3.Identity() if kind == "free" else anchor)
        turns = node.angle if kind == "revolute" else float
        if kind in ("revolute", "prismatic"):
            joint.reference = turns(node.number("ref", 0.0))
            limits = node.limits()
            if limits is not None:
                joint.lower, joint.upper = (turns(float(limit)) for limit in limits)
        elif kind == "ball" and node.limits() is not None:
            self.found.left_out.add("limits of the ball joints", name)
        if kind != "free" or node.tag == "joint":
            joint.damping, joint.friction = node.number("damping", 0.0), node.number("frictionloss", 0.0)
            joint.armature = node.number("armature", 0.0)
        joint.effort_lower, joint.effort = node.range("actuatorfrc").tolist()
        if np.any(node.vector("stiffness", None)):
            self.found.left_out.add("springs (stiffness) of joints", name)
        if len(node.vector("damping", None)) > 1:
            self.found.left_out.add("damping that grows with the speed, of joints", name)
        if joint.damping >= _HOLDS and joint.has_axis:
            joint.held = joint.reference
            self.found.left_out.add(f"motion against a damping of {_HOLDS:g} or more of joints", name)
        body.joints.append(joint)

    def _inertia(self, element: ElementTree.Element, body: TreeBody, geoms: Sequence[Geom]) -> pin.Inertia:
        """What <inertial> says, else what follows from the geoms."""
        written = element.find("inertial")
        from_geoms = self.mjcf.compiler.get("inertiafromgeom", "auto")
        least, most = self.groups
        chosen = [geom for geom in geoms if least <= geom.node.number("group", 0.0) <= most]
        if written is not None and not (from_geoms == "true" and chosen):
            return _read_written_inertia(self.mjcf.node(written), body.name)
        total = pin.Inertia.Zero()
        for geom in chosen if from_geoms != "false" else ():
            total = total + inertia_of(geom, self.folders)
        return total


def read_bodies(mjcf: Mjcf, folders: Sequence[Path]) -> Bodies:
    """Read the bodies of an MJCF.

    Raises
    ------
    RobotFileError, UnsupportedRobot
        Naming element and attribute.
    """
    compiler = mjcf.node(ElementTree.Element("compiler", dict(mjcf.compiler)))
    first, last = compiler.vector("inertiagrouprange", (0.0, math.inf), 2)
    reader = _Reader(mjcf, folders, mesh_assets(mjcf), materials_of(mjcf), (first, last))
    for world in mjcf.root.iterfind("worldbody"):
        reader.children(world, None, world.get("childclass"), pin.SE3.Identity())
    total = compiler.number("settotalmass", -1.0)
    if total > 0.0:
        found = math.fsum(body.inertia.mass for body in reader.found.bodies)
        if not found:
            raise RobotFileError(mjcf.path, f"<compiler>: settotalmass is {total:g}, but no body has a mass")
        for body in (body for body in reader.found.bodies if body.inertia.mass):
            body.inertia = scale_mass(body.inertia, body.inertia.mass * total / found)
    for body in reader.found.bodies:
        body.frames = [(reader.found.frame_of(name), place) for name, place in body.frames]
    for key, default in _OF_MASSES.items():
        if mjcf.compiler.get(key, default) not in (default, f"{default}.0"):
            reader.found.left_out.add("settings of <compiler>", key)
    return reader.found


def _read_written_inertia(node: XmlElement, body: str) -> pin.Inertia:
    where = f"{node.path}: body {show(body)}"
    mass = node.number("mass", 0.0)
    if mass < 0.0:
        raise UnsupportedRobot(f"{where}: mass is {mass:g} kg; a mass must be positive, or zero")
    place = node.placement
    if "fullinertia" in node.said:
        xx, yy, zz, xy, xz, yz = node.vector("fullinertia", None, 6)[:6]
        moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        moments = np.diag(node.three("diaginertia"))
    if np.any(np.diag(moments) < 0.0):
        raise UnsupportedRobot(
            f"{where}: a moment of inertia is negative: {np.diag(moments).tolist()} kg m^2"
        )
    return place.act(pin.Inertia(mass, np.zeros(3), moments))
