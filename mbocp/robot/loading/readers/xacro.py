"""Reading a xacro file: the package `xacro` expands its macros, then it is a URDF."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any, NamedTuple
from xml.parsers.expat import ExpatError

from mbocp._arrays import dataclass
from mbocp._files import is_file
from mbocp._text import list_names, shorten, show
from mbocp.exceptions import RobotFileError, suggest
from mbocp.robot.loading.addresses import package_folders
from mbocp.robot.loading.description import Description, Oddity, ReadOptions
from mbocp.robot.loading.readers import urdf as urdf_reader
from mbocp.robot.loading.readers.urdf import check_urdf, describe_urdf
from mbocp.robot.loading.readers.urdf_checks import find_oddities
from mbocp.robot.loading.readers.urdf_shapes import mesh_addresses
from mbocp.robot.loading.readers.urdf_xml import Urdf, has_macros, parse_xml, read_xml, urdf_of

_MAX_NAMES = 12
_lock = threading.Lock()  # the package keeps its state in its module


class XacroSource(NamedTuple):
    """What a xacro file is the source of.

    Attributes
    ----------
    urdf : Urdf
        The URDF, at the path of the xacro file.
    includes : tuple of Path
        Files that it includes.
    """

    urdf: Urdf
    includes: tuple[Path, ...] = ()


@dataclass(frozen=True)
class XacroReader:
    """The reader of xacro files with certain arguments; see `mbocp.robot.loading.robot_formats.Reader`.

    Parameters
    ----------
    folders : sequence of Path
        That hold packages which `$(find ...)` names.
    arguments : mapping
        Values of `<xacro:arg>`.
    """

    folders: Sequence[Path] = ()
    arguments: Mapping[str, Any] = field(default_factory=dict)
    _known: dict[Path, XacroSource] = field(default_factory=dict, repr=False)

    def read(self, path: Path, name: str, how: ReadOptions) -> Description:
        """Read a robot, as a URDF."""
        return describe_urdf(check_urdf(self.expand(path).urdf), how)

    def companions(self, path: Path) -> tuple[Path, ...]:
        """Files that it includes, and its SRDF."""
        return (*self.expand(path).includes, *urdf_reader.companions(path))

    def addresses(self, path: Path) -> tuple[str, ...]:
        """Addresses of its meshes."""
        return mesh_addresses(self.expand(path).urdf.root)

    def oddities(self, path: Path) -> Iterator[Oddity]:
        """What is odd in its URDF."""
        return find_oddities(path, self.expand(path).urdf.root)

    def expand(self, path: Path) -> XacroSource:
        """Expand a file.

        Raises
        ------
        RobotFileError
            If the package `xacro` is not installed, for an unknown argument, and for what `xacro` refuses.
        """
        if path not in self._known:
            self._known[path] = _expand(path, self.folders, self.arguments)
        return self._known[path]


class _Arguments(dict[str, str]):
    """Arguments that remember which of them a file asks for."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        super().__init__({name: _text_of(value) for name, value in given.items()})
        self.asked: set[str] = set()

    def __contains__(self, name: object) -> bool:
        self.asked.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.asked.add(name)
        return super().__getitem__(name)


def _text_of(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _expand(path: Path, folders: Sequence[Path], given: Mapping[str, Any]) -> XacroSource:
    text, root = read_xml(path)
    if not has_macros(root):
        if given:
            raise RobotFileError(path, f"has no xacro macros, and so no argument {show(next(iter(given)))}")
        return XacroSource(urdf_of(path, text, root))
    try:
        import xacro
    except ImportError as error:
        words = "has macros, which the package xacro expands: pip install 'mbocp[xacro]'"
        raise RobotFileError(path, words) from error
    arguments = _Arguments(given)
    with _lock:
        text, includes = _run(xacro, path, folders, arguments)
    unknown = [name for name in given if name not in arguments.asked]
    if unknown:
        known = sorted(arguments.asked)
        raise RobotFileError(
            path,
            f"has no argument {show(unknown[0])}: {suggest(unknown[0], known)}"
            if known
            else f"takes no arguments, got {list_names(unknown, _MAX_NAMES)}",
            "arguments",
        )
    return XacroSource(urdf_of(path, *parse_xml(path, text)), includes)


def _run(
    xacro: Any, path: Path, folders: Sequence[Path], arguments: _Arguments
) -> tuple[str, tuple[Path, ...]]:
    """The text of the URDF, and the files that were included."""
    from xacro import substitution_args

    def find(package: str) -> str:
        found = next(package_folders(package, path.parent, folders), None)
        if found is None:
            raise FileNotFoundError(
                f"no package folder {show(package)} found, name its parent in package_dirs or --package-dir"
            )
        return str(found)

    xacro.all_includes = []
    # Its own way needs an installed ROS; these are the two places in which it looks the function up.
    usual = substitution_args._eval_find
    substitution_args._eval_find = substitution_args._eval_dict["find"] = find
    try:
        document = xacro.process_file(str(path), mappings=arguments)
    except ExpatError as error:
        raise RobotFileError(Path(str(xacro.filestack[-1])), f"malformed XML: {error}") from error
    except Exception as error:  # expressions of the file may raise anything
        where = "" if not xacro.filestack or xacro.filestack[-1] == str(path) else f" {xacro.filestack[-1]}:"
        raise RobotFileError(path, f"xacro cannot expand it:{where} {_reason(error)}") from error
    finally:
        substitution_args._eval_find = substitution_args._eval_dict["find"] = usual
    return document.toxml(), tuple(
        dict.fromkeys(file for file in map(Path, xacro.all_includes) if is_file(file))
    )


def _reason(error: Exception) -> str:
    """What went wrong, on one line; an argument without a value by name."""
    inner: Any = error
    while getattr(inner, "exc", None) is not None:
        inner = inner.exc
    if type(inner).__name__ == "ArgException":
        return f"its argument {show(str(inner))} has no value: give it in robot.arguments"
    words = " ".join((str(error) or repr(error)).split())
    return shorten(words, 400)
