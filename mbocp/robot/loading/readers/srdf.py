"""SRDF: what stands beside a URDF about pairs of links that need not keep away from each other."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from mbocp._files import MEGABYTE, is_file, read_text
from mbocp.exceptions import RobotFileError, Unreadable

_MAX_BYTES = 4 * MEGABYTE


def find_srdf(urdf: Path) -> Path | None:
    """The SRDF of a URDF's name beside it, or in the folder srdf next to its own; None if there is none."""
    stem = urdf.stem
    while stem.endswith((".urdf", ".xacro")):  # panda.urdf.xacro
        stem = Path(stem).stem
    name = f"{stem}.srdf"
    places = (urdf.parent / name, urdf.parent.parent / "srdf" / name)
    return next((place for place in places if is_file(place)), None)


def disabled_by(srdf: Path) -> frozenset[frozenset[str]]:
    """Pairs of links of <disable_collisions>.

    Raises
    ------
    RobotFileError
        If it is no SRDF.
    """
    try:
        root = ElementTree.fromstring(read_text(srdf, expected="an SRDF", limit=_MAX_BYTES))
    except Unreadable as error:
        raise RobotFileError(srdf, error.reason) from error
    except (ElementTree.ParseError, ValueError) as error:
        raise RobotFileError(srdf, f"malformed XML: {error}") from error
    if root.tag != "robot":
        raise RobotFileError(srdf, f"not an SRDF: its root element is <{root.tag}>, expected <robot>")
    pairs = ((e.get("link1", ""), e.get("link2", "")) for e in root.iterfind("disable_collisions"))
    return frozenset(frozenset(pair) for pair in pairs)


def disabled_beside(urdf: Path) -> frozenset[frozenset[str]]:
    """Pairs of links of the SRDF of a URDF; none without one."""
    srdf = find_srdf(urdf)
    return frozenset() if srdf is None else disabled_by(srdf)
