"""The text of a URDF as a tree of elements, the numbers in its attributes, and its SRDF."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp._files import MEGABYTE, XML_LIMIT, is_file, read_text
from mbocp._text import show
from mbocp.exceptions import RobotFileError

LARGEST = 1e15  # of a length or mass; squares and products of a robot's numbers stay finite
# Numbers that both C's strtod and Python's float read: no underscores, no digits of other scripts.
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
_FOREIGN_ROOTS = {"sdf": "an SDF file", "mujoco": "a MuJoCo model", "COLLADA": "a Collada mesh"}

_UNBOUND_PREFIX = 27  # of expat
_RESERVED = {"xml", "xmlns"}
_MAX_LEVELS = 100  # of elements within each other; a URDF needs six
_MAX_BYTES = 4 * MEGABYTE


@dataclass(frozen=True)
class Urdf:
    """A URDF: path, text and element tree."""

    path: Path
    text: str
    root: ElementTree.Element

    @property
    def name(self) -> str:
        """The name that the URDF gives the robot."""
        return self.root.get("name") or self.path.stem


def parse_urdf(path: Path) -> Urdf:
    """Read a URDF as a tree of elements, within bounds.

    Raises
    ------
    RobotFileError
        If it is missing, malformed, or something else.
    """
    text, root = read_xml(path)
    if has_macros(root):
        raise RobotFileError(path, "has xacro macros in it: let its name end in .xacro")
    return urdf_of(path, text, root)


def read_xml(path: Path) -> tuple[str, ElementTree.Element]:
    """Read an XML file of a robot, within bounds: its text and its root element.

    Raises
    ------
    RobotFileError
        If it is missing or malformed.
    """
    if not os.path.lexists(path):
        raise RobotFileError(path, "no such file")
    with RobotFileError.where_unreadable(path):
        text = read_text(path, expected="a URDF, SDF or MJCF", limit=XML_LIMIT)
    return parse_xml(path, text)


def parse_xml(path: Path, text: str) -> tuple[str, ElementTree.Element]:
    """Parse the text of a file; the text that is returned has its declaration first."""
    text = _declare_first(text)
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        if getattr(error, "code", None) != _UNBOUND_PREFIX:
            raise RobotFileError(path, f"malformed XML: {error}") from error
        text = _declare_prefixes(path, text)
        root = ElementTree.fromstring(text)
    _check_depth(path, root)
    return text, root


def _declare_prefixes(path: Path, text: str) -> str:
    """Declare the prefixes of tags and attributes, as in `drake:mass`, which tools of robots read without."""
    prefixes, seen = set[str](), dict[str, int]()

    def start(tag: str, attributes: Mapping[str, str]) -> None:
        seen.setdefault(tag, parser.CurrentByteIndex)
        prefixes.update(word.split(":")[0] for word in (tag, *attributes) if ":" in word)

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    content = text.encode()
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise RobotFileError(path, f"malformed XML: {error}") from error
    root, place = next(iter(seen.items()))
    end = place + 1 + len(root.encode())
    said = "".join(f' xmlns:{p}="{p}"' for p in sorted(prefixes - _RESERVED) if f"xmlns:{p}=" not in text)
    return (content[:end] + said.encode() + content[end:]).decode()


def has_macros(root: ElementTree.Element) -> bool:
    """Whether there are macros of xacro in a file."""
    return any("xacro" in element.tag for element in root.iter())


def urdf_of(path: Path, text: str, root: ElementTree.Element) -> Urdf:
    """A URDF of what was parsed; refuse another format."""
    if root.tag != "robot":
        what = _FOREIGN_ROOTS.get(root.tag, f"XML with the root element <{root.tag}>")
        raise RobotFileError(path, f"not a URDF: it is {what}, expected the root element <robot>")
    return Urdf(path, text, root)


def _declare_first(text: str) -> str:
    """Put blank lines before an XML declaration behind it, where they may be; lines keep their numbers."""
    rest = text.lstrip()
    declaration, end, behind = rest.partition("?>")
    if rest == text or not rest.startswith("<?xml") or not end:
        return text
    return declaration + end + text[: len(text) - len(rest)] + behind


def _check_depth(path: Path, root: ElementTree.Element) -> None:
    level, depth = [root], 0
    while level:
        level, depth = [inner for element in level for inner in element], depth + 1
        if depth > _MAX_LEVELS:
            raise RobotFileError(path, f"XML elements are nested more than {_MAX_LEVELS} deep")


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
        raise RobotFileError(path, f"{what} is {show(text)}, expected {count} up to {LARGEST:g}")
    return np.array(values, dtype=np.float64)


def child_attribute(element: ElementTree.Element, tag: str, key: str) -> str | None:
    """An attribute of the first child of that tag; None if there is no such child or attribute."""
    child = element.find(tag)
    return None if child is None else child.get(key)


def find_srdf(urdf: Path) -> Path | None:
    """The SRDF of a URDF's name beside it, or in the folder srdf next to its own; None if there is none."""
    stem = urdf.stem
    while stem.endswith((".urdf", ".xacro")):  # panda.urdf.xacro
        stem = Path(stem).stem
    name = f"{stem}.srdf"
    places = (urdf.parent / name, urdf.parent.parent / "srdf" / name)
    return next((place for place in places if is_file(place)), None)


def pairs_disabled_by(srdf: Path) -> frozenset[frozenset[str]]:
    """Pairs of links of <disable_collisions>.

    Raises
    ------
    RobotFileError
        If it is no SRDF.
    """
    with RobotFileError.where_unreadable(srdf):
        text = read_text(srdf, expected="an SRDF", limit=_MAX_BYTES)
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise RobotFileError(srdf, f"malformed XML: {error}") from error
    if root.tag != "robot":
        raise RobotFileError(srdf, f"not an SRDF: its root element is <{root.tag}>, expected <robot>")
    pairs = ((e.get("link1", ""), e.get("link2", "")) for e in root.iterfind("disable_collisions"))
    return frozenset(frozenset(pair) for pair in pairs)


def pairs_disabled_beside(urdf: Path) -> frozenset[frozenset[str]]:
    """Pairs of links of the SRDF of a URDF; none without one."""
    srdf = find_srdf(urdf)
    return frozenset() if srdf is None else pairs_disabled_by(srdf)
