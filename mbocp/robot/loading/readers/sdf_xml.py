"""The text of an SDF: the model in it, numbers, and poses relative to links, joints and frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp._text import list_names, show
from mbocp.exceptions import RobotFileError, UnsupportedRobot, suggest
from mbocp.robot.kinematics import WORLD
from mbocp.robot.loading.readers.sdf_models import MODEL, PLACED, YES, Submodels, frame_of_pose, read_sdf
from mbocp.robot.loading.readers.urdf_xml import finite_numbers

_MAX_NAMES = 5
_MAX_ROW = 400  # frames that are placed in one another; Python's stack has 1000 levels
_NO_LIMIT = 1e16


@dataclass(frozen=True)
class Sdf:
    """The model of an SDF.

    Attributes
    ----------
    path : Path
    element : Element
        <model>.
    gravity : ndarray, shape (3,), or None
        Of the world that the model is in.
    includes : tuple of str
        Addresses of the files of models within the model, which are parts of it here.
    """

    path: Path
    element: ElementTree.Element
    gravity: Array | None
    includes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Of the model."""
        return self.element.get("name") or self.path.stem

    def numbers(
        self, element: ElementTree.Element, tag: str, where: str, default: tuple[float, ...]
    ) -> Array:
        """Numbers in a child; `default` if there is none.

        Raises
        ------
        RobotFileError
            For what is no number, and for another count.
        """
        return finite_numbers(self.path, f"{where}: {tag}", element.findtext(tag), default)

    def number(self, element: ElementTree.Element, tag: str, where: str, default: float) -> float:
        """The number in a child."""
        return float(self.numbers(element, tag, where, (default,))[0])

    def limit(self, element: ElementTree.Element, tag: str, where: str, default: float) -> float:
        """A limit: infinite from 1e16 on, as the format says, and for inf, as some files do."""
        try:
            value = float(element.findtext(tag) or default)
        except ValueError:
            value = math.nan
        if abs(value) >= _NO_LIMIT:
            return math.copysign(math.inf, value)
        return self.number(element, tag, where, default)

    def pose(self, element: ElementTree.Element, where: str) -> pin.SE3:
        """The <pose> of an element, in whichever frame it is given."""
        found = element.find("pose")
        if found is None or not (found.text or "").strip():
            return pin.SE3.Identity()
        if found.get("rotation_format") == "quat_xyzw":
            values = finite_numbers(self.path, f"{where}: pose", found.text, (0.0,) * 7)
            if not np.any(values[3:]):
                raise RobotFileError(
                    self.path, f"{where}: pose is {show(found.text)}: its quaternion is zero"
                )
            return pin.SE3(pin.Quaternion(values[3:] / np.linalg.norm(values[3:])).matrix(), values[:3])
        values = finite_numbers(self.path, f"{where}: pose", found.text, (0.0,) * 6)
        angles = np.radians(values[3:]) if found.get("degrees") in YES else values[3:]
        return pin.SE3(pin.rpy.rpyToMatrix(angles), values[:3])

    @cached_property
    def elements(self) -> dict[str, ElementTree.Element]:
        """Links, joints and frames by name."""
        found: dict[str, ElementTree.Element] = {}
        for element in (e for tag in PLACED for e in self.element.iterfind(tag)):
            name = element.get("name", "")
            if name in found or not name:
                raise RobotFileError(
                    self.path, f"the name {show(name)} is given to more than one link, joint or frame"
                )
            found[name] = element
        return found

    def place(self, name: str, passed: tuple[str, ...] = ()) -> pin.SE3:
        """Where a link, joint or frame is in the model.

        Raises
        ------
        RobotFileError
            For a name that there is not, and for frames that are placed in a circle.
        """
        if name == MODEL:
            return pin.SE3.Identity()
        if name not in self.elements:
            words = f"there is no link, joint or frame {show(name)}: {suggest(name, self.elements)}"
            raise RobotFileError(self.path, f"model {show(self.name)}: {words}")
        if name in passed:
            raise RobotFileError(
                self.path, f"frames are placed in a circle: {list_names(passed, _MAX_NAMES)}"
            )
        if len(passed) > _MAX_ROW:
            raise UnsupportedRobot(f"{self.path}: more than {_MAX_ROW} frames are placed in a row")
        element = self.elements[name]
        where = f"{element.tag} {show(name)}"
        placed_in = frame_of_pose(element) or self._carrier(element)
        return self.place(placed_in, (*passed, name)) * self.pose(element, where)

    def _carrier(self, element: ElementTree.Element) -> str:
        """What a joint or frame is placed on: the model, unless it says another."""
        if element.tag == "joint":
            return (element.findtext("child") or "").strip()
        return element.get("attached_to") or MODEL

    def pose_in(self, link: str, element: ElementTree.Element, where: str) -> pin.SE3:
        """The <pose> of a part of a link in the axes of the link."""
        frame, pose = frame_of_pose(element), self.pose(element, where)
        return self.place(link).actInv(self.place(frame)) * pose if frame else pose

    def link_of(self, name: str) -> str:
        """The link that a link, joint or frame moves with; the world by its name."""
        passed: list[str] = []
        while True:
            name = self._canonical if name == MODEL else name
            if name == WORLD:
                return name
            if name not in self.elements:
                words = f"there is no link or frame {show(name)}: {suggest(name, self.elements)}"
                raise RobotFileError(self.path, f"model {show(self.name)}: {words}")
            if self.elements[name].tag == "link":
                return name
            if name in passed:
                raise RobotFileError(self.path, f"frames move in a circle: {list_names(passed, _MAX_NAMES)}")
            passed.append(name)
            name = self._carrier(self.elements[name])

    @property
    def _canonical(self) -> str:
        first = self.element.find("link")
        named = "" if first is None else first.get("name", "")
        return self.element.get("canonical_link", named)

    def axis(self, joint: ElementTree.Element, tag: str, where: str) -> Array:
        """Unit vector of an <axis> in the axes of the joint."""
        element = joint.find(tag)
        xyz = None if element is None else element.find("xyz")
        text = None if xyz is None else xyz.text
        axis = finite_numbers(self.path, f"{where}: {tag} xyz", text, (0.0, 0.0, 1.0))
        norm = float(np.linalg.norm(axis))
        if norm == 0.0:
            raise RobotFileError(self.path, f"{where}: {tag} xyz is zero, expected a direction")
        frame = "" if xyz is None else xyz.get("expressed_in", "")
        if frame:
            turn = self.place(joint.get("name", "")).rotation.T @ self.place(frame).rotation
            axis = turn @ axis
        return axis / norm


def parse_sdf(path: Path, folders: Sequence[Path] = ()) -> Sdf:
    """Read the model of an SDF: its only one, or the only one of its world that is not static.

    Parameters
    ----------
    path : Path
    folders : sequence of Path
        That hold models which the file includes.

    Raises
    ------
    RobotFileError, UnsupportedRobot
        For a file that is missing, malformed or something else, and for no model or several.
    """
    root = read_sdf(path)
    world = root.find("world")
    inside = root if world is None else world
    models, includes = inside.findall("model"), inside.findall("include")
    if not models and len(includes) == 1:
        models = [ElementTree.Element("model", {"name": path.parent.name})]
        includes[0].set("merge", "true")
        models[0].append(includes[0])
    if len(models) > 1:
        models = [model for model in models if not is_static(model)]
    if len(models) != 1:
        names = list_names([model.get("name", "") for model in models], _MAX_NAMES) or "none"
        raise RobotFileError(path, f"expected one model that is not static, got {names}")
    submodels = Submodels(path, folders)
    submodels.put_in(models[0])
    frame = frame_of_pose(models[0])
    if frame not in ("", WORLD):
        words = f"model {show(models[0].get('name', ''))}: its pose is relative to {show(frame)}"
        raise UnsupportedRobot(f"{path}: {words}; give it in the world")
    gravity = None
    if world is not None and world.find("gravity") is not None:
        gravity = finite_numbers(path, "gravity", world.findtext("gravity"), (0.0, 0.0, -9.8))
    return Sdf(path, models[0], gravity, tuple(submodels.addresses))


def is_static(model: ElementTree.Element) -> bool:
    """Whether a model does not move."""
    return model.findtext("static", "").strip() in YES
