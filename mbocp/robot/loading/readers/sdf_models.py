"""The elements of an SDF; models within a model become links, joints and frames of it, called `model::name`.

`<include merge="true">` leaves the names as they are. What is placed in the inner model is placed in a frame
that stands for it: the model's name, or `_merged__NAME__model__`, as in the format's specification.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import field
from pathlib import Path
from xml.etree import ElementTree

from mbocp._arrays import dataclass
from mbocp._text import show
from mbocp.exceptions import RobotFileError, UnsupportedRobot
from mbocp.robot.kinematics import WORLD
from mbocp.robot.loading.addresses import resolve
from mbocp.robot.loading.readers.urdf_xml import read_xml

MODEL = "__model__"  # the frame of a model itself
PLACED = ("link", "joint", "frame")
YES = ("true", "1")
_IN_MODEL_AXES = (1, 4)  # up to this version axes of joints are those of the model
_NAMES_OF_KINDS = (1, 6)  # up to this version a joint and a link may have one name
_SUBMODELS = ("model", "include")
_NAMES = ("relative_to", "frame", "expressed_in", "attached_to")  # attributes that name a frame
_ENDS = {"joint": ("parent", "child"), "plugin": ("linkName", "jointName")}  # whose texts are names
_MAX_FILES = 100
_ONLINE = ("http://", "https://")


def read_sdf(path: Path) -> ElementTree.Element:
    """Read an SDF; axes of joints in the model's frame say so, and joints have names of their own.

    Raises
    ------
    RobotFileError
        For a file that is missing, malformed or something else.
    """
    _, root = read_xml(path)
    if root.tag != "sdf":
        words = f"it is XML with the root element <{root.tag}>, expected <sdf>"
        raise RobotFileError(path, f"not an SDF: {words}")
    version = _version(path, root.get("version", "1.7"))
    is_old = version <= _IN_MODEL_AXES
    for axis in (axis for tag in ("axis", "axis2") for axis in root.iterfind(f".//joint/{tag}")):
        xyz = axis.find("xyz")
        if xyz is not None and (is_old or axis.findtext("use_parent_model_frame", "").strip() in YES):
            xyz.attrib.setdefault("expressed_in", MODEL)
    if version <= _NAMES_OF_KINDS:
        for model in root.iter("model"):
            _rename_joints(model)
    return root


def _rename_joints(model: ElementTree.Element) -> None:
    """Call joints that have the name of a link `NAME_joint`, as Gazebo does."""
    links = {link.get("name") for link in model.iterfind("link")}
    for joint in model.iterfind("joint"):
        name = joint.get("name", "")
        if name in links:
            joint.set("name", f"{name}_joint")
            for turned in model.iterfind("plugin/jointName"):
                turned.text = f"{name}_joint" if (turned.text or "").strip() == name else turned.text


def _version(path: Path, text: str) -> tuple[int, int]:
    parts = text.split(".")[:2]
    if len(parts) != 2 or not all(part.isdecimal() and len(part) < 4 for part in parts):
        raise RobotFileError(path, f"its version is {show(text)}, expected two numbers: 1.7")
    return int(parts[0]), int(parts[1])


@dataclass
class Submodels:
    """What puts models into the model of a file.

    Attributes
    ----------
    path : Path
    folders : sequence of Path
        That hold models which the file names.
    addresses : list of str
        Of the files that were read, from the folder of `path`.
    """

    path: Path
    folders: Sequence[Path]
    addresses: list[str] = field(default_factory=list)

    def put_in(
        self, model: ElementTree.Element, file: Path | None = None, within: tuple[Path, ...] = ()
    ) -> None:
        """Put the models within a model into it, which is changed.

        Raises
        ------
        RobotFileError, UnsupportedRobot
            For a file that is missing, is no model or includes itself, and for what has no equivalent.
        """
        file = self.path if file is None else file
        for element in [each for each in model if each.tag in _SUBMODELS]:
            inner, of = element, file
            if element.tag == "include":
                inner, of = self._read(element, file, (*within, file))
            pose = element.find("pose")
            pose = inner.find("pose") if pose is None else pose
            name = element.findtext("name", "").strip() or inner.get("name", "")
            if inner.get("placement_frame") or element.findtext("placement_frame"):
                words = (
                    f"model {show(name)} is within a model and has a placement_frame, which is not supported"
                )
                raise UnsupportedRobot(f"{self.path}: {words}; give the pose of the model itself")
            self.put_in(inner, of, (*within, file))
            at = list(model).index(element)
            model.remove(element)
            model[at:at] = _parts(inner, name, pose, is_merged=element.get("merge") in YES)

    def _read(
        self, include: ElementTree.Element, file: Path, within: tuple[Path, ...]
    ) -> tuple[ElementTree.Element, Path]:
        """The model that an <include> names, and its file; its meshes are addressed from our folder."""
        uri = include.findtext("uri", "").strip()
        where = f"<include> {show(uri)}"
        if not uri:
            raise RobotFileError(self.path, "<include> has no <uri>: name there the model, or its file")
        if uri.startswith(_ONLINE):
            words = f"{where} is in the network; download it and name its folder"
            raise UnsupportedRobot(f"{self.path}: {words}")
        found = self._find(uri, file, where)
        if found in within:
            raise RobotFileError(self.path, f"{where} includes itself")
        if len(self.addresses) > _MAX_FILES:
            raise RobotFileError(self.path, f"more than {_MAX_FILES} models are included")
        inner = read_sdf(found).find("model")
        if inner is None:
            raise RobotFileError(self.path, f"{where}: there is no <model> in {found}")
        for mesh in inner.iterfind(".//mesh/uri"):
            mesh.text = self._from_here((mesh.text or "").strip(), found)
        return inner, found

    def _find(self, uri: str, file: Path, where: str) -> Path:
        ending = "" if uri.endswith(".sdf") else "/model.sdf"
        known = "://" in uri
        addresses = [f"{self._from_here(uri, file)}{ending}", *([] if known else [f"model://{uri}{ending}"])]
        reasons = []
        for address in addresses:
            try:
                found = resolve(address, self.path.parent, self.folders)
            except FileNotFoundError as error:
                reasons.append(str(error))
                continue
            self.addresses.append(address)
            return found
        raise RobotFileError(self.path, f"{where}: {'; '.join(reasons)}")

    def _from_here(self, uri: str, file: Path) -> str:
        """An address in another file as one in ours."""
        if "://" in uri or Path(uri).is_absolute() or file.parent == self.path.parent:
            return uri
        return Path(os.path.relpath(file.parent / uri, self.path.parent)).as_posix()


def _parts(
    model: ElementTree.Element, name: str, pose: ElementTree.Element | None, *, is_merged: bool
) -> list[ElementTree.Element]:
    """What a model has as parts of the one around it, and the frame that stands for it."""
    inside, prefix = (f"_merged__{name}__model__", "") if is_merged else (name, f"{name}::")

    def full_name(word: str) -> str:
        return inside if word == MODEL else word if word in ("", WORLD) else f"{prefix}{word}"

    parts = [each for each in model if each.tag in (*PLACED, "plugin")]
    first = next((each.get("name", "") for each in parts if each.tag == "link"), "")
    carrier = full_name(model.get("canonical_link", first))
    for part in parts:
        if part.tag == "link" or (part.tag == "frame" and not part.get("attached_to")):
            _place_in_model(part)
        _rename(part, full_name)
    frame = ElementTree.Element("frame", {"name": inside, **({"attached_to": carrier} if carrier else {})})
    if pose is not None:
        frame.append(deepcopy(pose))
    _place_in_model(frame)
    return [frame, *parts]


def _rename(part: ElementTree.Element, full_name: Callable[[str], str]) -> None:
    """Give a part, and what it names, the names that they have in the model around."""
    if part.tag in PLACED:
        part.set("name", full_name(part.get("name", "")))
    for element in part.iter():
        names = ("joint",) if element.tag == "mimic" else _NAMES
        element.attrib.update({key: full_name(element.attrib[key]) for key in names if key in element.attrib})
    for end in (each for each in part if each.tag in _ENDS.get(part.tag, ())):
        end.text = full_name((end.text or "").strip())


def _place_in_model(part: ElementTree.Element) -> None:
    """Say that a pose which names no frame is one in the model."""
    pose = part.find("pose")
    pose = ElementTree.SubElement(part, "pose") if pose is None else pose
    if not frame_of_pose(part):
        pose.set("relative_to", MODEL)


def frame_of_pose(element: ElementTree.Element) -> str:
    """The frame that the <pose> of an element names; empty if it names none."""
    pose = element.find("pose")
    return "" if pose is None else pose.get("relative_to") or pose.get("frame") or ""
