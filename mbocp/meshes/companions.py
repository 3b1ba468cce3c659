"""Other files that a mesh names: material files and pictures."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

from mbocp._files import TEXT_LIMIT, is_file, read_bytes
from mbocp.exceptions import Unreadable

MATERIALS = ".mtl"
_IMAGE = re.compile(r"<(?:init_from|ref)>\s*([^<>]+?)\s*</(?:init_from|ref)>")
_LIBRARY = re.compile(r"^[ \t]*mtllib[ \t]+(\S.*?)[ \t]*$", re.MULTILINE)
_MAP = re.compile(r"^[ \t]*map_Kd[ \t]+(?:.*[ \t])?(\S+)[ \t]*$", re.MULTILINE)


def companions(mesh: Path, content: bytes) -> tuple[Path, ...]:
    """Files that a Collada or OBJ file names and that are there; they may be anywhere, and of any kind.

    Parameters
    ----------
    mesh : Path
    content : bytes
        Of the mesh.
    """
    kind = mesh.suffix.lower()
    text = content.decode("utf-8", errors="replace") if kind in (".dae", ".obj") else ""
    named = _of_collada(mesh.parent, text) if kind == ".dae" else _of_wavefront(mesh.parent, text)
    return tuple(dict.fromkeys(path for path in named if is_file(path)))


def _of_collada(folder: Path, text: str) -> Iterator[Path]:
    for name in _IMAGE.findall(text):
        yield folder / unquote(name.removeprefix("file://")).replace("\\", "/")


def _of_wavefront(folder: Path, text: str) -> Iterator[Path]:
    for name in _LIBRARY.findall(text):
        library = folder / name
        if not is_file(library):
            continue
        yield library
        try:
            written = read_bytes(library, expected="a material file", limit=TEXT_LIMIT)
        except Unreadable:  # whoever draws the mesh says so
            continue
        yield from (library.parent / image for image in _MAP.findall(written.decode("utf-8", "replace")))
