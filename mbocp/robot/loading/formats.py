"""Formats of files that describe a robot.

A new format is a module in `readers/` with the functions of `Reader`, an entry of `FORMATS`, and its test.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from mbocp.robot.loading.description import Description
    from mbocp.robot.loading.inertias_table import InertiasTable


class Reader(Protocol):
    """The module of a format. Each function raises `RobotFileError` for a file that cannot be read."""

    def read(
        self,
        path: Path,
        name: str,
        *,
        free_flyer: bool | None,
        mimic: bool | None,
        folders: Sequence[Path],
        inertias: InertiasTable | None = None,
    ) -> Description:
        """Read a robot.

        Parameters
        ----------
        path : Path
        name : str
            Of the robot, if the file gives it none.
        free_flyer : bool, optional
            Whether the root link floats; None: as the file says.
        mimic : bool, optional
            Whether mimic joints follow their leaders; None: as is usual in this format.
        folders : sequence of Path
            That hold packages of meshes.
        inertias : InertiasTable, optional
            Where masses and inertias come from that the file does not give.
        """

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
    """

    kind: str
    name: str
    endings: tuple[str, ...]
    reader: Callable[[], Reader]
    file: str = ""
    about: str = ""


def _urdf() -> Reader:
    from mbocp.robot.loading.readers import urdf

    return urdf


def _robot_yaml() -> Reader:
    from mbocp.robot.loading.readers import robot_yaml  # YAML only for robots that have such a file

    return robot_yaml


_URDF = Format("urdf", "URDF", (".urdf", ".xml", ".xacro"), _urdf)
_YAML = Format("yaml", "robot.yaml", (".yaml",), _robot_yaml, "robot.yaml", "closed loops of robot.yaml")
FORMATS = {each.kind: each for each in (_YAML, _URDF)}
OTHER_KINDS = ("toml", "chain", "example")  # of sources, see `mbocp.robot.loading.sources`


def format_of(path: Path) -> Format:
    """Find the format of a file by its ending; a URDF may have any."""
    return next((each for each in FORMATS.values() if path.suffix in each.endings), _URDF)
