"""Formats of files that describe a robot.

A new format is a module in `readers/` with the functions of `Reader`, an entry of `FORMATS`, and its test.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from mbocp._files import root_tag
from mbocp._text import show
from mbocp.exceptions import RobotFileError
from mbocp.robot.loading.addresses import find_root_of_stored

if TYPE_CHECKING:
    from mbocp.robot.loading.description import Description, Oddity, ReadOptions


class Reader(Protocol):
    """The module of a format. Each function raises `RobotFileError` for a file that cannot be read."""

    def read(self, path: Path, name: str, how: ReadOptions) -> Description:
        """Read a robot; it is called `name` if the file gives it no name."""

    def companions(self, path: Path) -> tuple[Path, ...]:
        """Find files beside this one that belong to it."""

    def addresses(self, path: Path) -> tuple[str, ...]:
        """Find the addresses of meshes and of robots within it, relative to the file's folder."""

    def oddities(self, path: Path) -> Iterable[Oddity]:
        """Find what is allowed, and probably not meant."""


class Format(NamedTuple):
    """A format of files.

    Attributes
    ----------
    kind : str
        Its word in lists of stored files.
    name : str
        Its name in messages.
    endings : tuple of str
        Of its files, the usual one first.
    reader : callable
        Imports its module, for folders that hold packages.
    file : str
        Name of the file in a folder of the robot's name; empty if any will do.
    about : str
        What lists of robots say of such a folder.
    expander : callable, optional
        Makes what reads its files with arguments and makes URDFs of them, which results keep.
    root : str
        Root element by which a file that ends in .xml is known.
    """

    kind: str
    name: str
    endings: tuple[str, ...]
    reader: Callable[..., Reader]
    file: str = ""
    about: str = ""
    expander: Callable[..., Reader] | None = None
    root: str = ""


def _reader(module: str) -> Callable[..., Reader]:
    return lambda _folders: import_module(f"mbocp.robot.loading.readers.{module}")


def _sdf(folders: Sequence[Path]) -> Reader:
    from mbocp.robot.loading.readers.sdf import SdfReader

    return SdfReader(folders)


def _expander(*how: Any) -> Reader:
    from mbocp.robot.loading.readers.xacro import XacroReader

    return XacroReader(*how)


_URDF = Format("urdf", "URDF", (".urdf", ".xml"), _reader("urdf"))
_XACRO = Format("xacro", "xacro", (".xacro",), _expander, expander=_expander)
_robot_yaml = _reader("robot_yaml")  # YAML only for robots that have such a file
_YAML = Format("yaml", "robot.yaml", (".yaml",), _robot_yaml, "robot.yaml", "closed loops of robot.yaml")
_MJCF = Format("mjcf", "MJCF", (".mjcf",), _reader("mjcf"), root="mujoco")
_SDF = Format("sdf", "SDF", (".sdf", ".world"), _sdf, root="sdf")
FORMATS = {each.kind: each for each in (_YAML, _URDF, _XACRO, _MJCF, _SDF)}
OTHER_KINDS = ("toml", "chain", "example")  # of sources, see `mbocp.robot.loading.robot_sources`


def format_of(path: Path) -> Format:
    """Find the format of a file by its ending, that of an XML by its root element; a URDF may have any."""
    if path.suffix == ".xml":
        return next((each for each in FORMATS.values() if each.root and each.root == root_tag(path)), _URDF)
    return next((each for each in FORMATS.values() if path.suffix in each.endings), _URDF)


def reader_of(path: Path, folders: Sequence[Path] = (), arguments: Mapping[str, Any] | None = None) -> Reader:
    """Find the reader of a file.

    Parameters
    ----------
    path : Path
    folders : sequence of Path
        That hold packages which the file names.
    arguments : mapping, optional
        Values of the arguments of the file; what a result keeps has them already.

    Raises
    ------
    RobotFileError
        For arguments of a file that takes none.
    """
    found = format_of(path)
    if found.expander is not None:
        return found.expander(folders, arguments or {})
    if arguments and find_root_of_stored(path.parent) is None:
        words = f"got {show(dict(arguments))}, but only xacro files take arguments"
        raise RobotFileError(path, words, "arguments")
    return found.reader(folders)
