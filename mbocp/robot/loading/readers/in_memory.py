"""Robots that are made when they are asked for: chains of equal links, "chain_1", ..., and simple bodies.

A chain shows how things scale with the number of bodies: links of 0.25 m and 0.5 kg on revolute joints about
the same axis, all with motors; at zero the chain hangs straight down. A body is given by mass and shape: what
robots of a world carry, or stand at.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

from mbocp.exceptions import UnsupportedRobot
from mbocp.robot.loading.description import Description, ReadOptions
from mbocp.robot.loading.readers.urdf import describe_urdf
from mbocp.robot.loading.readers.urdf_xml import Urdf
from mbocp.robot.loading.robot_toml import RobotTable
from mbocp.robot.payload import Payload

EXAMPLE = "chain_8"
MAX_LINKS = 1000  # as of any robot, see mbocp.robot.loading.readers.urdf_checks
_LENGTH, _RADIUS, _MASS = 0.25, 0.018, 0.5  # [m, m, kg]
_ACROSS = _MASS * (3 * _RADIUS**2 + _LENGTH**2) / 12  # [kg m^2], of a cylinder
_ALONG = _MASS * _RADIUS**2 / 2
_COLORS = ("blue", "orange")
_HEAD = """<?xml version="1.0"?>
<robot name="{name}">
  <material name="steel"><color rgba="0.35 0.35 0.38 1"/></material>
  <material name="blue"><color rgba="0.16 0.36 0.62 1"/></material>
  <material name="orange"><color rgba="0.95 0.60 0.10 1"/></material>
  <link name="link_0">
    <visual>
      <origin xyz="0 0 0.035"/>
      <geometry><box size="0.16 0.12 0.03"/></geometry>
      <material name="steel"/>
    </visual>
  </link>
"""
_LINK = """  <link name="link_{n}">
    <inertial>
      <origin xyz="0 0 {half}"/>
      <mass value="{mass}"/>
      <inertia ixx="{across}" ixy="0" ixz="0" iyy="{across}" iyz="0" izz="{along}"/>
    </inertial>
    <visual>
      <origin rpy="1.5707963267948966 0 0"/>
      <geometry><cylinder radius="{joint}" length="{width}"/></geometry>
      <material name="steel"/>
    </visual>
    <visual>
      <origin xyz="0 0 {half}"/>
      <geometry><cylinder radius="{radius}" length="{length}"/></geometry>
      <material name="{color}"/>
    </visual>
  </link>
  <joint name="joint_{n}" type="revolute">
    <origin xyz="0 0 {place}"/>
    <parent link="link_{before}"/><child link="link_{n}"/>
    <axis xyz="0 -1 0"/>
    <limit effort="0" velocity="0"/>
  </joint>
"""
_TIP = """  <link name="tip"/>
  <joint name="tip_mount" type="fixed">
    <origin xyz="0 0 {place}"/>
    <parent link="link_{before}"/><child link="tip"/>
  </joint>
</robot>
"""
OBJECT_LINK = "body"  # the one link of an object, at the centre of its shape
_COLOR = "0.92 0.62 0.18 1"
_INERTIA = '<inertia ixx="{}" iyy="{}" izz="{}" ixy="{}" ixz="{}" iyz="{}"/>'


def num_links(name: str) -> int | None:
    """Number of links of the chain with this name; None if the name is not that of a chain.

    Raises
    ------
    UnsupportedRobot
        For a chain of no link, or of more than MAX_LINKS.
    """
    found = re.fullmatch(r"chain_(-?\d+)", name)
    if found is None:
        return None
    links = int(found[1])
    if not 1 <= links <= MAX_LINKS or found[1] != str(links):
        raise UnsupportedRobot(
            f"robot {name!r}: a chain has 1 to {MAX_LINKS} links: chain_1, chain_2, ..., chain_{MAX_LINKS}"
        )
    return links


def chain_description(links: int) -> str:
    """One line about a chain."""
    return f"Hanging chain of {links} equal {'links' if links > 1 else 'link'} on actuated revolute joints"


def describe_chain(name: str, *, free_flyer: bool) -> Description:
    """Describe the chain of this name."""
    links = num_links(name) or 0
    found = describe_urdf(chain_urdf(links), ReadOptions(free_flyer, mimic=False))
    return replace(found, source=None, table=RobotTable(description=chain_description(links)))


def chain_urdf(links: int) -> Urdf:
    """URDF of a chain, in memory: its path names no file.

    Parameters
    ----------
    links : int
        Number of links, at least 1.
    """
    name = f"chain_{links}"
    text = _HEAD.format(name=name) + "".join(_link(n) for n in range(1, links + 1))
    text += _TIP.format(place=-_LENGTH, before=f"{links}")
    return Urdf(Path(f"{name}.urdf"), text, ElementTree.fromstring(text))


def _link(number: int) -> str:
    return _LINK.format(
        n=number,
        before=number - 1,
        half=-_LENGTH / 2,
        place=-_LENGTH if number > 1 else 0,
        mass=_MASS,
        across=f"{_ACROSS:.6g}",
        along=f"{_ALONG:.6g}",
        joint=1.5 * _RADIUS,
        width=3 * _RADIUS,
        radius=_RADIUS,
        length=_LENGTH,
        color=_COLORS[number % 2],
    )


def describe_object(name: str, shape: Payload, *, free_flyer: bool) -> Description:
    """Describe a simple body; without a free-flyer it stands still."""
    return replace(describe_urdf(_urdf(name, shape), ReadOptions(free_flyer, mimic=False)), source=None)


def _urdf(name: str, shape: Payload) -> Urdf:
    """URDF with one link, shown and solid alike, in memory: its path names no file.

    Parameters
    ----------
    name : str
    shape : Payload
        Mass, centre of mass, inertia and shape; the shape is drawn about the link's origin.
    """
    robot = ElementTree.Element("robot", name=name)
    link = ElementTree.SubElement(robot, "link", name=OBJECT_LINK)
    if shape.mass > 0.0:
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "origin", xyz=_join(shape.com))
        ElementTree.SubElement(inertial, "mass", value=repr(shape.mass))
        inertial.append(ElementTree.fromstring(_INERTIA.format(*map(repr, shape.inertia))))
    if (form := _form(shape)) is not None:
        visual = ElementTree.SubElement(link, "visual")
        ElementTree.SubElement(visual, "geometry").append(form)
        hull = ElementTree.SubElement(link, "collision")
        ElementTree.SubElement(hull, "geometry").append(form)
        material = ElementTree.SubElement(visual, "material", name="object")
        ElementTree.SubElement(material, "color", rgba=_COLOR)
    text = ElementTree.tostring(robot, encoding="unicode")
    return Urdf(Path(f"{name}.urdf"), text, robot)


def _form(shape: Payload) -> ElementTree.Element | None:
    if shape.box is not None:
        return ElementTree.Element("box", size=_join(shape.box))
    if shape.sphere is not None:
        return ElementTree.Element("sphere", radius=repr(shape.sphere))
    if shape.cylinder is not None:
        radius, length = shape.cylinder
        return ElementTree.Element("cylinder", radius=repr(radius), length=repr(length))
    return None


def _join(numbers: Sequence[float]) -> str:
    return " ".join(map(repr, numbers))
