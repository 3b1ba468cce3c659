"""What is odd in a URDF: allowed, and probably not meant."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from mbocp._text import list_names, show
from mbocp.robot.loading.readers.urdf_inertia import Inertial, read_inertials
from mbocp.robot.loading.readers.urdf_xml import child_attribute, finite_number

_TOLERANCE = 0.02  # of the largest moment of inertia: numbers with few digits
_MAX_RADIUS = 3.0  # [m] of gyration; larger links are rare, and mm in place of m are not
_MAX_NAMES = 4  # joints of which the same is said, named in one line
_WITH_LIMITS = ("revolute", "prismatic")


def find_oddities(path: Path, root: ElementTree.Element) -> Iterator[str]:
    """Find what is odd in a URDF; one line for each.

    Parameters
    ----------
    path : Path
    root : Element
        ``<robot>``.
    """
    moving = {child_attribute(joint, "child", "link") for joint in root.iterfind("joint")}
    for inertial in read_inertials(path, root):
        if inertial.link in moving:
            yield from _of_inertia(inertial)
    alike: dict[str, list[str]] = {}
    for joint in root.iterfind("joint"):
        for words in _of_joint(joint):
            alike.setdefault(words, []).append(joint.get("name", ""))
    for words, names in alike.items():
        yield f"{'joints' if len(names) > 1 else 'joint'} {list_names(names, _MAX_NAMES)}: {words}"


def _of_inertia(inertial: Inertial) -> Iterator[str]:
    where, moments = f"link {show(inertial.link)}", np.linalg.eigvalsh(inertial.inertia)
    size = float(np.abs(moments).max())
    if inertial.mass > 0.0 and size == 0.0:
        yield f"{where}: {inertial.mass:g} kg without inertia: a point, which nothing resists to turn"
    elif inertial.mass == 0.0 and size > 0.0:
        yield f"{where}: inertia without mass: right for a rotor, else a number is missing"
    elif moments[2] > (1.0 + _TOLERANCE) * (moments[0] + moments[1]):
        principal = ", ".join(f"{m:.3g}" for m in moments)
        yield (
            f"{where}: its principal moments {principal} kg m^2 violate the triangle inequality: the "
            "largest is above the sum of the others; no body has that"
        )
    if inertial.mass > 0.0 and math.sqrt(size / inertial.mass) > _MAX_RADIUS:
        radius = math.sqrt(size / inertial.mass)
        what = f"{size:.3g} kg m^2 for {inertial.mass:g} kg"
        yield f"{where}: {what} is a body {2 * radius:.3g} m across: are the units right?"


def _of_joint(joint: ElementTree.Element) -> Iterator[str]:
    """What is odd about one joint, without its name."""
    kind = joint.get("type")
    if kind not in (*_WITH_LIMITS, "continuous") or joint.find("mimic") is not None:
        return
    limit = {
        key: finite_number(child_attribute(joint, "limit", key))
        for key in ("lower", "upper", "effort", "velocity")
    }
    if kind in _WITH_LIMITS and limit["lower"] is not None and limit["upper"] is not None:
        yield from _of_range(limit["lower"], limit["upper"])
    for key in ("effort", "velocity"):
        if limit[key] is None:
            yield f"no {key} in <limit>: limits.{key} = true does not bound it"
        elif limit[key] == 0.0:
            yield f"zero {key} in <limit>: limits.{key} = true would not let it move"


def _of_range(lower: float, upper: float) -> Iterator[str]:
    if lower >= upper:
        yield f"its lower limit {lower:g} is not below its upper {upper:g}: it cannot move"
    elif lower > 0.0 or upper < 0.0:
        words = "exclude zero, where poses begin unless start.q says another"
        yield f"its limits {lower:g} ... {upper:g} {words}"
