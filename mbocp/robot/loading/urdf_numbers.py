"""Numbers in a URDF's attributes, and the names of their elements in messages."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from mbocp._arrays import Array
from mbocp._text import shown
from mbocp.exceptions import RobotFileError

LARGEST = 1e15  # of a length or mass; squares and products of a robot's numbers stay finite
# Numbers that both C's strtod and Python's float read: no underscores, no digits of other scripts.
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


def finite_number(text: str | None) -> float | None:
    """The number that `text` is; None if it is none, not finite, or larger than `LARGEST`."""
    if text is None or not _NUMBER.fullmatch(text.strip()):
        return None
    value = float(text)
    return value if abs(value) <= LARGEST else None


def finite_numbers(path: Path, what: str, text: str | None, default: tuple[float, ...]) -> Array:
    """As many finite numbers as `default` has, which is returned if there is no text.

    Raises
    ------
    RobotFileError
        Naming file and `what`: "joint 'elbow': axis xyz".
    """
    if text is None:
        return np.array(default)
    values = [finite_number(word) for word in text.split()]
    if len(values) != len(default) or None in values:
        count = f"{len(default)} finite numbers" if len(default) > 1 else "a finite number"
        raise RobotFileError(path, f"{what} is {shown(text)}, expected {count} up to {LARGEST:g}")
    return np.array(values, dtype=np.float64)


def child_attribute(element: ElementTree.Element, tag: str, key: str) -> str | None:
    """An attribute of the first child of that tag; None if there is no such child or attribute."""
    child = element.find(tag)
    return None if child is None else child.get(key)
