"""Other files that a mesh names: material files, and pictures, images only and from the robot's folders only.

A mesh file names its pictures by any path, and a replay carries them to whoever gets the page. So a path is
followed only to a picture, and only below the folders that belong to the robot.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

from mbocp._files import MEGABYTE, TEXT_LIMIT, is_file, read_bytes
from mbocp._text import shorten
from mbocp.exceptions import Unreadable

PICTURE_LIMIT = 32 * MEGABYTE  # of one picture [bytes]
_MAGIC = (  # first bytes, and what browsers call the kind
    (b"\x89PNG\r\n\x1a\n", "png"),
    (b"\xff\xd8\xff", "jpeg"),
    (b"GIF87a", "gif"),
    (b"GIF89a", "gif"),
)
_FOLDERS = ("urdf", "urdfs")  # by custom beside meshes/ and textures/
PACKAGE = "package.xml"
MATERIALS = ".mtl"
_IMAGE = re.compile(r"<(?:init_from|ref)>\s*([^<>]+?)\s*</(?:init_from|ref)>")
_LIBRARY = re.compile(r"^[ \t]*mtllib[ \t]+(\S.*?)[ \t]*$", re.MULTILINE)
_MAP = re.compile(r"^[ \t]*map_Kd[ \t]+(?:.*[ \t])?(\S+)[ \t]*$", re.MULTILINE)


class Picture(NamedTuple):
    """An image file: what kind it is ("png", "jpeg", ...), and its content."""

    kind: str
    content: bytes


def picture_folders(robots: Iterable[Path], mesh: Path) -> tuple[Path, ...]:
    """Folders that the pictures of a mesh may come from.

    They are the folders of the robot's files (if one is called urdf, the one above, too) and the packages,
    marked by a package.xml, that these and the mesh belong to. What robot.toml or a problem file say does
    not count, for they may be foreign, too.
    """
    folders, files = [], [mesh.resolve()]
    for file in (path.resolve() for path in robots):
        files.append(file)
        folders.append(file.parent)
        if file.parent.name in _FOLDERS:
            folders.append(file.parent.parent)
    for file in files:
        package = next((folder for folder in file.parents if is_file(folder / PACKAGE)), None)
        folders += [] if package is None else [package]
    return tuple(dict.fromkeys(folder.resolve() for folder in folders))


def read_picture(path: Path, folders: tuple[Path, ...]) -> Picture:
    """Read a picture that a mesh names.

    Raises
    ------
    Unreadable
        If it is not below the folders (after following links), is too large, or no image that pages show.
    """
    try:
        file = path.resolve(strict=True)
    except (OSError, RuntimeError, ValueError) as error:
        raise Unreadable("no such file") from error
    if not any(file.is_relative_to(folder) for folder in folders):
        own = ", ".join(shorten(str(folder)) for folder in folders) or "none"
        raise Unreadable(
            f"is outside the robot's folders ({own}); move it there, or mark the package of the mesh by a "
            "package.xml"
        )
    content = read_bytes(file, expected="a picture", limit=PICTURE_LIMIT)
    kind = _kind(content)
    if kind is None:
        raise Unreadable("is no picture that a page shows (PNG, JPEG, GIF, BMP or WebP)")
    return Picture(kind, content)


def _kind(content: bytes) -> str | None:
    for magic, kind in _MAGIC:
        if content.startswith(magic):
            return kind
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        return "webp"
    size, header = (int.from_bytes(content[k : k + 4], "little") for k in (2, 14))
    if content[:2] == b"BM" and size == len(content) and header in (12, 40, 52, 56, 64, 108, 124):
        return "bmp"
    return None


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
