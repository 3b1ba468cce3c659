"""The text of an MJCF as one tree of elements: includes, classes of defaults, numbers in attributes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp._text import show
from mbocp.exceptions import RobotFileError, suggest
from mbocp.robot.loading.readers.tree import TreeJoint
from mbocp.robot.loading.readers.urdf_xml import LARGEST, finite_number, read_xml

_MAX_FILES = 100
_MAIN = "main"
_MIN_NORM = 1e-12  # of an axis or quaternion
ACTUATORS = (
    "general",
    "motor",
    "position",
    "velocity",
    "intvelocity",
    "damper",
    "cylinder",
    "muscle",
    "adhesion",
)
# Tags that set the same defaults.
_KINDS = dict.fromkeys(ACTUATORS, "actuator") | {"fixed": "tendon", "spatial": "tendon"}
_YES = ("true", "1")


@dataclass(frozen=True)
class XmlElement:
    """An element with the defaults of its class.

    Attributes
    ----------
    path : Path
        For messages.
    element : Element
    said : mapping
        Attributes, those of the class included.
    compiler : mapping
        Attributes of <compiler>.
    """

    path: Path
    element: ElementTree.Element
    said: Mapping[str, str]
    compiler: Mapping[str, str]

    @property
    def tag(self) -> str:
        """Of the element."""
        return self.element.tag

    @property
    def where(self) -> str:
        """What the element is called in messages."""
        name = self.said.get("name")
        return f"<{self.tag}>" if name is None else f"<{self.tag}> {show(name)}"

    def text(self, key: str, default: str = "") -> str:
        """An attribute as it is written."""
        return self.said.get(key, default)

    def flag(self, key: str, default: bool) -> bool:
        """An attribute that is true or false; `default` if it says neither."""
        word = self.said.get(key, "auto")
        return default if word == "auto" else word in _YES

    def limits(self, of: str = "") -> Array | None:
        """Two limits, as of "force" in `forcerange`; None if there are none, or they are turned off."""
        key = f"{of}range"
        limits = self.vector(key, (0.0, 0.0), 2)
        is_said = key in self.said and self.compiler.get("autolimits", "true") == "true"
        return limits if self.flag(f"{of}limited", is_said) else None

    def range(self, of: str) -> Array:
        """Two limits; infinite where there are none."""
        limits = self.limits(of)
        return np.array([-math.inf, math.inf]) if limits is None or not limits.any() else limits

    def number(self, key: str, default: float) -> float:
        """The first number of an attribute."""
        return float(self.vector(key, (default,))[0])

    def vector(self, key: str, default: tuple[float, ...] | None, least: int = 1) -> Array:
        """Numbers of an attribute, filled up with those of `default`; None takes any number of them.

        Raises
        ------
        RobotFileError
            For what is no number, and for too few.
        """
        text = self.said.get(key)
        if text is None:
            return np.array(() if default is None else default, dtype=float)
        values = [finite_number(word) for word in text.split()]
        if None in values or len(values) < least:
            words = f"expected at least {least} finite numbers up to {LARGEST:g}"
            raise RobotFileError(self.path, f"{self.where}: {key} is {show(text)}, {words}")
        filled = values if default is None else [*values, *default[len(values) :]][: max(len(default), 1)]
        return np.array(filled, dtype=float)

    def three(self, key: str, default: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
        """Three numbers."""
        return self.vector(key, default, 3)

    def direction(self, key: str, default: tuple[float, float, float]) -> Array:
        """A unit vector."""
        return self._unit(key, self.three(key, default))

    def angle(self, value: float) -> float:
        """An angle in the unit of the file [rad]."""
        return value if self.compiler.get("angle", "degree") == "radian" else math.radians(value)

    @property
    def placement(self) -> pin.SE3:
        """Of pos and the orientation, in whichever way it is written."""
        return pin.SE3(self.rotation, self.three("pos"))

    @property
    def rotation(self) -> Array:
        """Of quat, axisangle, euler, xyaxes or zaxis."""
        if "axisangle" in self.said:
            values = self.vector("axisangle", None, 4)
            return _array(pin.exp3(self._unit("axisangle", values[:3]) * self.angle(values[3])))
        if "euler" in self.said:
            return self._euler(self.vector("euler", None, 3))
        if "xyaxes" in self.said:
            values = self.vector("xyaxes", None, 6)
            x = self._unit("xyaxes", values[:3])
            y = self._unit("xyaxes", values[3:6] - x * (x @ values[3:6]))
            return np.column_stack([x, y, np.cross(x, y)])
        if "zaxis" in self.said:
            return turn_to(self._unit("zaxis", self.vector("zaxis", None, 3)))
        w, x, y, z = self._unit("quat", self.vector("quat", (1.0, 0.0, 0.0, 0.0), 4))
        return _array(pin.Quaternion(w, x, y, z).matrix())

    def _euler(self, angles: Array) -> Array:
        turn = np.eye(3)
        sequence = self.compiler.get("eulerseq", "xyz")
        if len(sequence) != 3 or set(sequence.lower()) - set("xyz"):
            raise RobotFileError(self.path, f"<compiler>: eulerseq is {show(sequence)}, expected three axes")
        for letter, angle in zip(sequence, angles, strict=False):
            step = pin.exp3(np.eye(3)["xyz".index(letter.lower())] * self.angle(angle))
            turn = turn @ step if letter.islower() else step @ turn
        return turn

    def _unit(self, key: str, values: Array) -> Array:
        norm = float(np.linalg.norm(values))
        if norm < _MIN_NORM:
            raise RobotFileError(self.path, f"{self.where}: {key} is zero, expected a direction")
        return values / norm


@dataclass(frozen=True)
class Mjcf:
    """An MJCF: its path, its tree with what it includes, and its classes.

    Attributes
    ----------
    path : Path
    root : Element
    includes : tuple of Path
    compiler : mapping
        Attributes of <compiler>.
    classes : mapping
        Attributes of each tag, by class.
    """

    path: Path
    root: ElementTree.Element
    includes: tuple[Path, ...]
    compiler: Mapping[str, str] = field(default_factory=dict)
    classes: Mapping[str, Mapping[str, Mapping[str, str]]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The name that it gives the robot."""
        return self.root.get("model") or self.path.stem

    def node(self, element: ElementTree.Element, inherited: str | None = None) -> XmlElement:
        """The element with the attributes of its class, or of the one that it inherits from its body.

        Raises
        ------
        RobotFileError
            For a class that there is not.
        """
        name = element.get("class") or inherited or _MAIN
        if name not in self.classes:
            raise RobotFileError(self.path, f"<{element.tag}>: there is no class {show(name)}")
        kind = _KINDS.get(element.tag, element.tag)
        said = {**self.classes[name].get(kind, {}), **element.attrib}
        return XmlElement(self.path, element, said, self.compiler)

    def each(self, section: str) -> Iterator[ElementTree.Element]:
        """Elements within all sections of this name."""
        for found in self.root.iterfind(section):
            yield from found


def find_named_joint(node: XmlElement, key: str, joints: Mapping[str, TreeJoint]) -> TreeJoint:
    """Find the joint that an attribute names.

    Raises
    ------
    RobotFileError
        If there is none.
    """
    name = node.text(key)
    if name not in joints:
        words = f"there is no joint {show(name)}: {suggest(name, joints)}"
        raise RobotFileError(node.path, f"{node.where}: {words}")
    return joints[name]


def parse_mjcf(path: Path) -> Mjcf:
    """Read an MJCF and what it includes.

    Raises
    ------
    RobotFileError
        For a file that is missing, malformed, something else, or includes itself.
    """
    includes: list[Path] = []
    root = _with_includes(path, (), includes, path.parent)
    if root.tag != "mujoco":
        words = f"it is XML with the root element <{root.tag}>, expected <mujoco>"
        raise RobotFileError(path, f"not an MJCF: {words}")
    compiler: dict[str, str] = {}
    for element in root.iterfind("compiler"):
        compiler.update(element.attrib)
    if compiler.get("coordinate") == "global":
        words = "global coordinates are not supported; MuJoCo 2.3.3 or older converts them"
        raise RobotFileError(path, f"<compiler>: {words}")
    classes: dict[str, dict[str, dict[str, str]]] = {_MAIN: {}}
    for element in root.iterfind("default"):
        _read_class(element, classes, element.get("class", _MAIN), classes[_MAIN])
    return Mjcf(path, root, tuple(dict.fromkeys(includes)), compiler, classes)


def _with_includes(
    path: Path, within: tuple[Path, ...], includes: list[Path], folder: Path
) -> ElementTree.Element:
    if path in within:
        raise RobotFileError(path, "includes itself")
    if len(includes) > _MAX_FILES:
        raise RobotFileError(path, f"more than {_MAX_FILES} files are included")
    _, root = read_xml(path)
    for parent in list(root.iter()):
        for element in parent.findall("include"):
            named = element.get("file", "")
            found = next((f / named for f in (folder, path.parent) if (f / named).is_file()), folder / named)
            includes.append(found)
            inner = _with_includes(found, (*within, path), includes, folder)
            at = list(parent).index(element)
            parent.remove(element)
            for number, each in enumerate(inner):
                parent.insert(at + number, each)
    return root


def _read_class(
    element: ElementTree.Element,
    classes: dict[str, dict[str, dict[str, str]]],
    name: str,
    inherited: Mapping[str, Mapping[str, str]],
) -> None:
    own = classes.setdefault(name, {tag: dict(said) for tag, said in inherited.items()})
    for inner in element:
        if inner.tag != "default":
            kind = _KINDS.get(inner.tag, inner.tag)
            own.setdefault(kind, {}).update(inner.attrib)
    for inner in element.iterfind("default"):
        _read_class(inner, classes, inner.get("class", ""), own)


def turn_to(direction: Array) -> Array:
    """The smallest turn that takes the z axis to a unit vector."""
    return _array(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), direction).matrix())


def _array(matrix: Array) -> Array:
    return np.array(matrix, dtype=float)
