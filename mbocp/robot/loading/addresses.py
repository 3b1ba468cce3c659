"""Addresses of files in a robot's file: package://, model://, file://, absolute and relative ones."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from mbocp._files import is_file, is_folder, path_of
from mbocp._text import shorten, show
from mbocp.robot.loading.unpacked import unpacked_file, unpacked_root

NO_PACKAGE = ": no package folder "  # in the message about an address without one
_SCHEMES = ("package://", "model://")


def resolve(uri: str, base: Path, package_dirs: Iterable[Path]) -> Path:
    """Find the file that an address means: package://, model://, file://, absolute, or relative to `base`.

    A package is looked for in `package_dirs`, in ROS_PACKAGE_PATH and AMENT_PREFIX_PATH, and in the folders
    above the file. What was unpacked with a stored robot is where its list says.

    Raises
    ------
    FileNotFoundError
        If there is no such file; the text says what was looked for.
    """
    root = unpacked_root(base)
    if root is not None:
        return unpacked_file(root, uri, base)
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
    folders = [*package_dirs, *_environment_packages(), base, *base.parents]
    roots = [folder / package for folder in folders if is_folder(folder / package)]
    roots += [folder for folder in folders if folder.name == package]
    if not roots:
        raise FileNotFoundError(
            f"{shorten(uri)}{NO_PACKAGE}{show(package)} found, name its parent in package_dirs or "
            "--package-dir"
        )
    for root in roots:
        if is_file(root / rest):
            return root / rest
    raise FileNotFoundError(f"{shorten(uri)}: {shorten(str(roots[0] / rest))} does not exist")


def _environment_packages() -> list[Path]:
    ros = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    ament = [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    return ros + ament


def absolute(path: str | Path, base: Path | None) -> Path:
    """Absolute path of what is relative to `base`, or to the working directory."""
    expanded = path_of(path)
    return (expanded if base is None else base / expanded).resolve()
