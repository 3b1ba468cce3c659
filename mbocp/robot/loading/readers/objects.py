"""Simple bodies that are given by mass and shape: what robots of a world carry, or stand at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

from mbocp.robot.loading.description import Description, Reading
from mbocp.robot.loading.readers.urdf import describe_urdf
from mbocp.robot.loading.readers.urdf_xml import Urdf
from mbocp.robot.payload import Payload

OBJECT_LINK = "body"  # the one link of an object, at the centre of its shape
_COLOR = "0.92 0.62 0.18 1"
_INERTIA = '<inertia ixx="{}" iyy="{}" izz="{}" ixy="{}" ixz="{}" iyz="{}"/>'


def describe_object(name: str, shape: Payload, *, free_flyer: bool) -> Description:
    """Describe a simple body; without a free-flyer it stands still."""
    return replace(describe_urdf(_urdf(name, shape), Reading(free_flyer, mimic=False)), source=None)


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
