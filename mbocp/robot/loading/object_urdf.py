"""URDF of a simple body that is given by mass and shape: what robots of a world carry, or stand at."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from mbocp.robot.loading.urdf import Urdf
from mbocp.robot.payload import Payload

OBJECT_LINK = "body"  # the one link of an object, at the centre of its shape
_COLOR = "0.92 0.62 0.18 1"
_INERTIA = '<inertia ixx="{}" iyy="{}" izz="{}" ixy="{}" ixz="{}" iyz="{}"/>'


def solid_inertia(shape: Payload) -> tuple[float, float, float, float, float, float]:
    """Moments of inertia ixx, iyy, izz (and zero products) of a shape filled evenly [kg m^2].

    Zero without a shape.
    """
    m = shape.mass
    if shape.box is not None:
        x, y, z = (side**2 for side in shape.box)
        moments = ((y + z) / 12, (x + z) / 12, (x + y) / 12)
    elif shape.sphere is not None:
        moments = (0.4 * shape.sphere**2,) * 3
    elif shape.cylinder is not None:
        radius, length = shape.cylinder
        moments = ((3 * radius**2 + length**2) / 12,) * 2 + (radius**2 / 2,)
    else:
        moments = (0.0, 0.0, 0.0)
    xx, yy, zz = (m * moment for moment in moments)
    return xx, yy, zz, 0.0, 0.0, 0.0


def object_urdf(name: str, shape: Payload) -> Urdf:
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
        ElementTree.SubElement(inertial, "origin", xyz=_joined(shape.com))
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
        return ElementTree.Element("box", size=_joined(shape.box))
    if shape.sphere is not None:
        return ElementTree.Element("sphere", radius=repr(shape.sphere))
    if shape.cylinder is not None:
        radius, length = shape.cylinder
        return ElementTree.Element("cylinder", radius=repr(radius), length=repr(length))
    return None


def _joined(numbers: Sequence[float]) -> str:
    return " ".join(map(repr, numbers))
