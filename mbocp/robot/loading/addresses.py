"""Addresses of files in a robot's file: package://, model://, file://, absolute and relative ones.

Names and addresses of robots and meshes mean other things on other machines. So a folder into which the files
of a stored robot were unpacked has a list of what each of them meant, asked from which folder, where the
robot was stored; within it nothing else counts.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from mbocp._files import MEGABYTE, is_file, is_folder, path_of, read_text
from mbocp._text import shorten, show
from mbocp.exceptions import Unreadable

MANIFEST = "package.xml"  # in the folder of a ROS package
_MANIFEST_LIMIT = MEGABYTE
_PACKAGE_NAME = re.compile(r"<name>\s*([^\s<]+)\s*</name>")
NO_PACKAGE = ": no package folder "  # in the message about an address without one
_SCHEMES = ("package://", "model://")
PREFIX = "mbocp-robot-"  # of the folder's name
LIST = "mbocp-robot.json"


def resolve(uri: str, base: Path, package_dirs: Iterable[Path]) -> Path:
    """Find the file that an address means: package://, model://, file://, absolute, or relative to `base`.

    A package is looked for in `package_dirs`, in the folders of ROS_PACKAGE_PATH, AMENT_PREFIX_PATH and
    GZ_SIM_RESOURCE_PATH, and in those above the file. What was unpacked with a stored robot is where its
    list says.

    Raises
    ------
    FileNotFoundError
        If there is no such file; the text says what was looked for.
    """
    root = find_root_of_stored(base)
    if root is not None:
        return find_file_of_stored(root, uri, base)
    for scheme in _SCHEMES:
        if uri.startswith(scheme):
            package, _, rest = uri.removeprefix(scheme).partition("/")
            return _in_package(package, rest, uri, base, package_dirs)
    path = Path(uri.removeprefix("file://"))
    path = path if path.is_absolute() else base / path
    if not is_file(path):
        raise FileNotFoundError(f"{shorten(str(path))} does not exist")
    return path


def _in_package(package: str, rest: str, uri: str, base: Path, package_dirs: Iterable[Path]) -> Path:
    roots = []
    for root in package_folders(package, base, package_dirs):
        if is_file(root / rest):
            return root / rest
        roots.append(root)
    if not roots:
        raise FileNotFoundError(
            f"{shorten(uri)}{NO_PACKAGE}{show(package)} found, name its parent in package_dirs or "
            "--package-dir"
        )
    raise FileNotFoundError(f"{shorten(uri)}: {shorten(str(roots[0] / rest))} does not exist")


def package_folders(package: str, base: Path, package_dirs: Iterable[Path]) -> Iterator[Path]:
    """Yield folders that may be the package, the likeliest first; those of other names are looked into last.

    Parameters
    ----------
    package : str
        Name of the package.
    base : Path
        Folder of the file that names it.
    package_dirs : iterable of Path
        Folders to look in first.
    """
    folders = [*package_dirs, *_environment_packages(), base, *base.parents]
    yield from (folder / package for folder in folders if is_folder(folder / package))
    yield from (folder for folder in folders if _is_package(folder, package))


def _is_package(folder: Path, package: str) -> bool:
    """Whether a folder is called so, or its package.xml says so: folders of repositories have other names."""
    if folder.name == package:
        return True
    try:
        manifest = read_text(folder / MANIFEST, limit=_MANIFEST_LIMIT)
    except Unreadable:
        return False
    named = _PACKAGE_NAME.search(manifest)
    return named is not None and named[1] == package


def _environment_packages() -> list[Path]:
    """Folders of packages: of a ROS 1 workspace, those of its repositories, too."""
    ros = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    inner = [folder for path in ros if path.is_dir() for folder in sorted(path.iterdir()) if folder.is_dir()]
    ament = [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    models = [Path(p) for p in os.environ.get("GZ_SIM_RESOURCE_PATH", "").split(os.pathsep) if p]
    return [*ros, *inner, *ament, *models]


def absolute(path: str | Path, base: Path | None) -> Path:
    """Absolute path of what is relative to `base`, or to the working directory."""
    expanded = path_of(path)
    return (expanded if base is None else base / expanded).resolve()


def find_root_of_stored(folder: Path | None) -> Path | None:
    """The folder of a stored robot that `folder` belongs to; None if it belongs to none."""
    if folder is None or PREFIX not in str(folder):
        return None
    above = (folder, *folder.parents)
    return next((f for f in above if f.name.startswith(PREFIX) and (f / LIST).is_file()), None)


def find_file_of_stored(root: Path, address: str, folder: Path) -> Path:
    """File that an address in a file of `folder` meant.

    Raises
    ------
    FileNotFoundError
        If it was missing, or left out.
    """
    found = find_row(root, "addresses", address, folder)
    if found is None:
        raise FileNotFoundError(f"{shorten(address)} was missing where the result was written")
    path = root / str(found["path"])
    if not path.is_file():
        raise FileNotFoundError(f"{shorten(address)} was left out of the result")
    return path


def find_row(root: Path, table: str, asked: str, folder: Path) -> Mapping[str, Any] | None:
    """What a name or an address meant, asked from `folder`; None if that was not asked before."""
    try:
        within = folder.relative_to(root).as_posix()
    except ValueError:
        return None
    rows: list[Mapping[str, Any]] = _list_of(root)[table]
    return next((row for row in rows if (row["asked"], row["within"]) == (asked, within)), None)


@lru_cache(maxsize=8)
def _list_of(root: Path) -> dict[str, Any]:
    return json.loads((root / LIST).read_text(encoding="utf-8"))
