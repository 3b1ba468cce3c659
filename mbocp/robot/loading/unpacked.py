"""A folder into which the files of a stored robot were unpacked, and what its list says of addresses.

Names and addresses of robots and meshes mean other things on other machines. So the folder has a list of what
each of them meant, asked from which folder, where the robot was stored; within it nothing else counts.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from mbocp._text import shorten

PREFIX = "mbocp-robot-"  # of the folder's name
LIST = "mbocp-robot.json"

Addresses = Mapping[str, Mapping[str, Any]]


def unpacked_root(folder: Path | None) -> Path | None:
    """The folder of a stored robot that `folder` belongs to; None if it belongs to none."""
    if folder is None or PREFIX not in str(folder):
        return None
    above = (folder, *folder.parents)
    return next((f for f in above if f.name.startswith(PREFIX) and (f / LIST).is_file()), None)


def unpacked_source(root: Path, spec: str, folder: Path) -> Mapping[str, Any] | None:
    """What `spec` meant, asked from `folder`; None if nobody asked for it where the robot was stored."""
    return _read_asked(root, "sources", spec, folder)


def unpacked_file(root: Path, address: str, folder: Path) -> Path:
    """File that an address in a file of `folder` meant.

    Raises
    ------
    FileNotFoundError
        If it was missing, or left out.
    """
    found = _read_asked(root, "addresses", address, folder)
    if found is None:
        raise FileNotFoundError(f"{shorten(address)} was missing where the result was written")
    path = root / str(found["path"])
    if not path.is_file():
        raise FileNotFoundError(f"{shorten(address)} was left out of the result")
    return path


def _read_asked(root: Path, table: str, asked: str, folder: Path) -> Mapping[str, Any] | None:
    try:
        within = folder.relative_to(root).as_posix()
    except ValueError:
        return None
    rows: list[Mapping[str, Any]] = _list_of(root)[table]
    return next((row for row in rows if (row["asked"], row["within"]) == (asked, within)), None)


@lru_cache(maxsize=8)
def _list_of(root: Path) -> dict[str, Any]:
    listed: dict[str, Any] = json.loads((root / LIST).read_text(encoding="utf-8"))
    return listed
