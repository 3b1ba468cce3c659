"""Formats of files that describe a robot.

A new format is a module in `readers/` with the functions of `Reader`, an entry of `FORMATS`, and its test.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from mbocp._files import root_tag
from mbocp._text import show
from mbocp.exceptions import RobotFileError
from mbocp.robot.loading.addresses import unpacked_root

if TYPE_CHECKING:
    from mbocp.robot.loading.description import Description, Reading
    from mbocp.robot.loading.readers.xacro import XacroReader


class Reader(Protocol):
    """The module of a format. Each function raises `RobotFileError` for a file that cannot be read."""

    def read(self, path: Path, name: str, how: Reading) -> Description:
        """Read a robot; it is called `name` if the file gives it no name."""

    def companions(self, path: Path) -> tuple[Path, ...]:
        """Find files beside this one that belong to it."""

    def addresses(self, path: Path) -> tuple[str, ...]:
        """Find the addresses of meshes, relative to the file's folder."""

    def oddities(self, path: Path) -> Iterable[str]:
        """Find what is allowed, and probably not meant; one line for each."""


@dataclass(frozen=True)
class Format:
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
        Imports its module.
    file : str
        Name of the file in a folder of the robot's name; empty if any will do.
    about : str
        What lists of robots say of such a folder.
    expander : callable, optional
        Imports what reads its files with arguments and makes URDFs of them, which results keep.
    root : str
        Root element by which a file that ends in .xml is known.
    """

    kind: str
    name: str
    endings: tuple[str, ...]
    reader: Callable[[], Reader]
    file: str = ""
    about: str = ""
    expander: Callable[[], type[XacroReader]] | None = None
    root: str = ""


def _urdf() -> Reader:
    from mbocp.robot.loading.readers import urdf

    return urdf


def _robot_yaml() -> Reader:
    from mbocp.robot.loading.readers import robot_yaml  # YAML only for robots that have such a file

    return robot_yaml


def _mjcf() -> Reader:
    from mbocp.robot.loading.readers import mjcf

    return mjcf


def _sdf() -> Reader:
    from mbocp.robot.loading.readers import sdf

    return sdf


def _xacro() -> type[XacroReader]:
    from mbocp.robot.loading.readers.xacro import XacroReader

    return XacroReader


_URDF = Format("urdf", "URDF", (".urdf", ".xml"), _urdf)
_XACRO = Format("xacro", "xacro", (".xacro",), lambda: _xacro()(), expander=_xacro)
_YAML = Format("yaml", "robot.yaml", (".yaml",), _robot_yaml, "robot.yaml", "closed loops of robot.yaml")
_MJCF = Format("mjcf", "MJCF", (".mjcf",), _mjcf, root="mujoco")
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
        return found.expander()(folders, arguments or {})
    if arguments and unpacked_root(path.parent) is None:
        words = f"got {show(dict(arguments))}, but only xacro files take arguments"
        raise RobotFileError(path, words, "arguments")
    return found.reader()
