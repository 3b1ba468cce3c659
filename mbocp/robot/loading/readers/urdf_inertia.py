"""Masses and inertias of a URDF: only numbers are accepted, impossible inertias cause a warning."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._text import show, warn_caller
from mbocp.exceptions import UnsupportedRobot
from mbocp.robot.loading.readers.urdf_xml import LARGEST, child_attribute, finite_number, finite_numbers
from mbocp.robot.warnings import ImpossibleInertiaWarning

_ROUND_OFF = 1e-9  # [kg m^2]; exporters print a zero moment of inertia as a tiny negative number
_PRINT_TOLERANCE = 0.02  # of a link's largest moment: error of numbers with few digits
_KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_PLACES = (("ixy", 0, 1), ("ixz", 0, 2), ("iyz", 1, 2))
_MAX_NAMES = 5  # links named in one warning


class Inertial(NamedTuple):
    """An <inertial>: mass [kg] and rotational inertia about the centre of mass, shape (3, 3) [kg m^2]."""

    link: str
    mass: float
    inertia: Array


def read_inertials(path: Path, root: ElementTree.Element) -> tuple[Inertial, ...]:
    """All masses and inertias of a URDF.

    Raises
    ------
    RobotFileError, UnsupportedRobot
        For what is no number, and for a negative mass or moment of inertia, naming link and attribute.
    """
    found = []
    for link in root.iterfind("link"):
        element = link.find("inertial")
        if element is not None:
            found.append(_read(path, link.get("name", ""), element))
    return tuple(found)


def is_rotor(inertial: Inertial) -> bool:
    """Whether it has inertia and no mass, as the idealised rotor of a motor has."""
    return inertial.mass == 0.0 and float(np.abs(inertial.inertia).max()) > _ROUND_OFF


def fault_of(inertial: Inertial) -> str:
    """Say why a link cannot have this inertia; an empty text if it can."""
    if float(np.abs(inertial.inertia).max()) <= _ROUND_OFF:
        return f"{inertial.mass:g} kg without inertia"
    return _fault(inertial)


def tell_impossible_inertias(path: Path, model: pin.Model, inertials: Sequence[Inertial] = ()) -> None:
    """Warn of bodies whose inertia no distribution of mass has.

    A body is what fixed joints join: a small part with muddled numbers on a large one is harmless.

    Parameters
    ----------
    path : Path
        For messages.
    model : pin.Model
    inertials : sequence of Inertial
        Those of the links that the model was built from, to be named.

    Warns
    -----
    ImpossibleInertiaWarning
        Once for the robot, naming links or joints, numbers and what is wrong with them.
    """
    told = [words for joint in range(1, model.njoints) for words in _faults(joint, model, inertials)]
    if told:
        more = f"; and {len(told) - _MAX_NAMES} more" if len(told) > _MAX_NAMES else ""
        warn_caller(
            f"{path}: physically impossible inertias ({'; '.join(told[:_MAX_NAMES])}{more}); they are used "
            "as they stand. Check units (kg m^2) and axes",
            ImpossibleInertiaWarning,
        )


def _faults(joint: int, model: pin.Model, inertials: Sequence[Inertial]) -> list[str]:
    """Faults of the inertias of a body's links, or of the body as a whole; none of a body that can be."""
    inertia = model.inertias[joint]
    whole = _fault(Inertial(model.names[joint], float(inertia.mass), np.asarray(inertia.inertia)))
    if not whole:
        return []
    links = {f.name for f in model.frames if f.parentJoint == joint and f.type == pin.FrameType.BODY}
    told = [
        f"link {show(inertial.link)}: {words}"
        for inertial in inertials
        if inertial.link in links and (words := _fault(inertial))
    ]
    return told or [f"what joint {show(model.names[joint])} moves: {whole}"]


def _read(path: Path, link: str, element: ElementTree.Element) -> Inertial:
    where = f"{path}: link {show(link)}"
    for key in ("xyz", "rpy"):
        text = child_attribute(element, "origin", key)
        finite_numbers(path, f"link {show(link)}: inertial origin {key}", text, (0.0,) * 3)
    mass = _number(where, "mass", child_attribute(element, "mass", "value"))
    if mass < 0:
        raise UnsupportedRobot(
            f"{where}: mass is {mass:g} kg; a mass must be positive, or zero for a massless link or a rotor"
        )
    written = element.find("inertia")
    if written is None:
        return Inertial(link, mass, np.zeros((3, 3)))
    values = {key: _number(where, key, written.get(key)) for key in _KEYS}
    for key in ("ixx", "iyy", "izz"):
        if values[key] < -_ROUND_OFF:
            raise UnsupportedRobot(
                f"{where}: {key} is {values[key]:g} kg m^2; a moment of inertia cannot be negative"
            )
    xx, xy, xz, yy, yz, zz = (values[key] for key in _KEYS)
    return Inertial(link, mass, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def _number(where: str, key: str, text: str | None) -> float:
    value = finite_number(text)
    if value is None:
        raise UnsupportedRobot(f"{where}: {key} is {show(text)}, expected a finite number up to {LARGEST:g}")
    return value


def _fault(inertial: Inertial) -> str:
    """Fault of an inertia; an empty text if there is none."""
    inertia = inertial.inertia
    size = float(np.abs(inertia).max())
    tolerance = max(_ROUND_OFF, _PRINT_TOLERANCE * size)
    if not np.isfinite(size) or size <= tolerance:
        return ""
    moments = size * np.linalg.eigvalsh(inertia / size)  # scaled: huge numbers have squares, too
    if moments[0] < -tolerance:
        negative = f"a principal moment of inertia is {moments[0]:.3g} kg m^2, but none can be negative"
        return negative + _cause(inertia)
    # A rotor is an idealisation: it has no mass, and often but one moment of inertia.
    if inertial.mass > 0 and moments[2] - moments[0] - moments[1] > tolerance:
        principal = ", ".join(f"{m:.3g}" for m in moments)
        return f"of its principal moments {principal} kg m^2 the largest is above the sum of the others"
    return ""


def _cause(inertia: Array) -> str:
    """The product of inertia that is too large for its moments, if it is one alone."""
    for key, i, j in _PLACES:
        bound = math.sqrt(max(float(inertia[i, i]), 0.0)) * math.sqrt(max(float(inertia[j, j]), 0.0))
        if abs(inertia[i, j]) > bound * (1.0 + _PRINT_TOLERANCE):
            sides = f"i{'xyz'[i] * 2} = {inertia[i, i]:g} and i{'xyz'[j] * 2} = {inertia[j, j]:g}"
            return f" ({key} = {inertia[i, j]:g} is too large for {sides})"
    return ""
