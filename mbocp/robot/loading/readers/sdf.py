"""Reading an SDF, Gazebo's format: joints that the tree does not take close loops, and rotors push."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp._text import show
from mbocp.exceptions import RobotFileError, UnsupportedRobot
from mbocp.robot.collision.geometry import LinkShape
from mbocp.robot.loading.addresses import resolve
from mbocp.robot.loading.description import Description, Oddity, ReadOptions
from mbocp.robot.loading.readers.sdf_joints import read_joints
from mbocp.robot.loading.readers.sdf_xml import Sdf, parse_sdf
from mbocp.robot.loading.readers.tree import (
    ELLIPSOIDS,
    LeftOut,
    MissingMesh,
    TreeBody,
    TreeJoint,
    TreeShape,
    describe_tree,
    oddities_of,
)
from mbocp.robot.loading.readers.urdf_xml import finite_numbers
from mbocp.robot.loading.robot_toml import tables_from

_ROTOR = "multicopter-motor-model"
_OTHERS = ("lift-drag", "hydrodynamics", "buoyancy", "thruster", "wind-effects", "apply-link-wrench")
_TURNS = {"ccw": 1.0, "cw": -1.0}
_FULL_SPEED = 838.0  # [rad/s], as Gazebo has it where none is given


def read_rotors(sdf: Sdf, joints: Iterable[TreeJoint], left_out: LeftOut) -> list[dict[str, Any]]:
    """Thrusters for the rotors that a plugin turns; their joints, which turn too fast to matter, are held.

    The thrust is `motorConstant` times the square of the speed, along the z axis of the rotor's link, and the
    moment against its turn is `momentConstant` times the thrust. What drags a rotor that flies is left out.

    Raises
    ------
    RobotFileError
        For a rotor whose link or joint there is not, and for numbers without sense.
    """
    known, rows, others = {joint.name: joint for joint in joints}, list[dict[str, Any]](), set[str]()
    for plugin in sdf.element.iterfind("plugin"):
        file, link = plugin.get("filename", ""), plugin.findtext("linkName", "").strip()
        if _ROTOR not in file or plugin.findtext("motorType", "velocity").strip() != "velocity":
            if _ROTOR in file or any(word in file for word in _OTHERS):
                others.add(file)
            continue
        name, turn = (
            plugin.findtext("jointName", "").strip(),
            plugin.findtext("turningDirection", "cw").strip(),
        )
        where = f"rotor {show(name)}"
        if name not in known or link not in sdf.elements or turn not in _TURNS:
            words = (
                f"{where}: its joint, its link {show(link)} or its turning direction {show(turn)} is unknown"
            )
            raise RobotFileError(sdf.path, words)
        by_square = sdf.number(plugin, "motorConstant", where, 8.54858e-06)
        most = by_square * sdf.number(plugin, "maxRotVelocity", where, _FULL_SPEED) ** 2
        if not most > 0.0:
            raise RobotFileError(
                sdf.path, f"{where}: its greatest thrust is {most:g} N, expected more than 0"
            )
        ratio = -_TURNS[turn] * sdf.number(plugin, "momentConstant", where, 0.016)
        known[name].held = 0.0
        rows.append(
            {"type": "thruster", "frame": link, "name": name, "torque_ratio": ratio, "effort": [0.0, most]}
        )
    for file in sorted(others):
        left_out.add("forces of plugins", file)
    return rows


_MOMENTS = ("ixx", "iyy", "izz")
_PRODUCTS = ("ixy", "ixz", "iyz")
_NO = ("false", "0")
_WITHOUT_BODY = ("empty", "plane", "heightmap", "image")
# What makes them of which numbers.
_SHAPES: Mapping[str, tuple[Any, Mapping[str, int]]] = {
    "box": (coal.Box, {"size": 3}),
    "sphere": (coal.Sphere, {"radius": 1}),
    "cylinder": (coal.Cylinder, {"radius": 1, "length": 1}),
    "capsule": (coal.Capsule, {"radius": 1, "length": 1}),
}


@dataclass(frozen=True)
class SdfReader:
    """The reader of SDF files; see `mbocp.robot.loading.robot_formats.Reader`.

    Parameters
    ----------
    folders : sequence of Path
        That hold models which a file includes.
    """

    folders: Sequence[Path] = ()
    _known: dict[Path, Sdf] = field(default_factory=dict, repr=False)

    def read(self, path: Path, name: str, how: ReadOptions) -> Description:
        """Read a robot; joints that mimic others are coupled to them unless `mimic` is False."""
        sdf, left_out = self._parse(path), LeftOut()
        links = read_links(sdf, how.folders, left_out)
        found = read_joints(sdf, links, left_out)
        couplings = [] if how.mimic is False else found.couplings
        joints = (joint for body in found.bodies for joint in body.joints)
        rotors = read_rotors(sdf, joints, left_out)
        table: dict[str, Any] = {"constraint": [*found.loops, *couplings], "actuator": rotors}
        if sdf.gravity is not None:
            table["gravity"] = sdf.gravity.tolist()
        return describe_tree(path, sdf.name, found.bodies, tables_from(table), left_out, how)

    def companions(self, path: Path) -> tuple[Path, ...]:
        """Files of the models that it includes."""
        includes = self._parse(path).includes
        return tuple(dict.fromkeys(resolve(each, path.parent, self.folders) for each in includes))

    def addresses(self, path: Path) -> tuple[str, ...]:
        """Addresses of the models that it includes, and of all meshes, each once."""
        sdf = self._parse(path)
        uris = (mesh.findtext("uri") or "" for mesh in sdf.element.iter("mesh"))
        return tuple(dict.fromkeys((*sdf.includes, *(uri.strip() for uri in uris))))

    def oddities(self, path: Path) -> Iterator[Oddity]:
        """Joints that cannot move, and links with the mass that Gazebo gives those that say none."""
        sdf, left_out = self._parse(path), LeftOut()
        for link in sdf.element.iterfind("link"):
            if link.find("inertial") is None:
                words = "no <inertial>: it has 1 kg and 1 kg m^2 about each axis"
                yield Oddity(words, link=link.get("name", ""))
        links = read_links(sdf, (), left_out)
        yield from oddities_of(read_joints(sdf, links, left_out).bodies)

    def _parse(self, path: Path) -> Sdf:
        if path not in self._known:
            self._known[path] = parse_sdf(path, self.folders)
        return self._known[path]


def read_links(sdf: Sdf, folders: Sequence[Path], left_out: LeftOut) -> dict[str, TreeBody]:
    """Links as bodies placed in the model, by name."""
    bodies: dict[str, TreeBody] = {}
    for element in sdf.element.iterfind("link"):
        name = element.get("name", "")
        body = TreeBody(name, None, sdf.place(name), inertia=_inertia(sdf, element, name))
        bodies[name] = body
        if element.findtext("gravity", "true").strip() in _NO:
            left_out.add("gravity turned off for the links", name)
        if element.find("inertial/fluid_added_mass") is not None:
            left_out.add("the fluid that moves with the links", name)
        _add_shapes(sdf, element, body, folders, left_out)
    for element in sdf.element.iterfind("frame"):
        name = element.get("name", "")
        link = sdf.link_of(name)
        if link in bodies:
            bodies[link].frames.append((name, bodies[link].placement.actInv(sdf.place(name))))
    return bodies


def _add_shapes(
    sdf: Sdf, link: ElementTree.Element, body: TreeBody, folders: Sequence[Path], left_out: LeftOut
) -> None:
    """Shapes of a link, those whose mesh is missing as such."""
    elements = [inner for inner in link if inner.tag in ("visual", "collision")]
    for number, inner in enumerate(elements):
        is_drawn, form = inner.tag == "visual", inner.find("geometry/*")
        if form is None or form.tag in _WITHOUT_BODY:
            continue
        if form.tag not in (*_SHAPES, "mesh"):
            told = f"shapes <{form.tag}>, neither drawn nor solid, of"
            left_out.add(ELLIPSOIDS if form.tag == "ellipsoid" else told, body.name)
            continue
        try:
            shape = _shape(sdf, inner, form, body.name, number, folders)
        except FileNotFoundError as error:
            body.missing.append(MissingMesh(f"link {show(body.name)}", str(error), not is_drawn))
            continue
        if form.find("submesh") is not None:
            left_out.add("<submesh>, in whose place stands the whole mesh, of", body.name)
        body.shapes.append(TreeShape(shape, _color(sdf, inner), is_drawn, not is_drawn))


def _inertia(sdf: Sdf, link: ElementTree.Element, name: str) -> pin.Inertia:
    """What <inertial> says; the format gives 1 kg and 1 kg m^2 to what says nothing."""
    where = f"link {show(name)}"
    written = link.find("inertial")
    if written is None:
        return pin.Inertia(1.0, np.zeros(3), np.eye(3))
    if written.get("auto") == "true":
        raise UnsupportedRobot(
            f"{sdf.path}: {where}: <inertial auto> is not supported; write mass and inertia"
        )
    mass = sdf.number(written, "mass", where, 1.0)
    inertia = written.find("inertia")
    inside = ElementTree.Element("inertia") if inertia is None else inertia
    xx, yy, zz = (sdf.number(inside, key, where, 1.0) for key in _MOMENTS)
    xy, xz, yz = (sdf.number(inside, key, where, 0.0) for key in _PRODUCTS)
    if mass < 0.0 or min(xx, yy, zz) < 0.0:
        least = f"mass {mass:g} kg, moments {xx:g}, {yy:g}, {zz:g} kg m^2"
        raise UnsupportedRobot(f"{sdf.path}: {where}: none of its {least} can be negative")
    moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return sdf.pose(written, f"{where}: inertial").act(pin.Inertia(mass, np.zeros(3), moments))


def _shape(
    sdf: Sdf,
    element: ElementTree.Element,
    form: ElementTree.Element,
    link: str,
    number: int,
    folders: Sequence[Path],
) -> LinkShape:
    """Shape of a <visual> or <collision>."""
    where = f"{element.tag} {show(element.get('name', ''))} of link {show(link)}"
    placement = sdf.pose_in(link, element, where)
    if form.tag == "mesh":
        path = resolve((form.findtext("uri") or "").strip(), sdf.path.parent, folders)
        scale = sdf.numbers(form, "scale", where, (1.0, 1.0, 1.0))
        return LinkShape(link, number, where, coal.BVHModelOBBRSS(), str(path), scale, placement)
    make, keys = _SHAPES[form.tag]
    sizes = [
        size for key, count in keys.items() for size in sdf.numbers(form, key, where, (1.0,) * count).tolist()
    ]
    if not all(size > 0.0 for size in sizes):
        raise RobotFileError(sdf.path, f"{where}: its sizes are {sizes}, expected positive ones")
    return LinkShape(link, number, where, make(*sizes), "", np.ones(3), placement)


def _color(sdf: Sdf, element: ElementTree.Element) -> Array | None:
    text = element.findtext("material/diffuse")
    if text is None:
        return None
    words = text.split()
    filled = " ".join([*words, "1"]) if len(words) == 3 else text
    return finite_numbers(sdf.path, "material diffuse", filled, (0.7, 0.7, 0.7, 1.0))
