"""Mesh formats that coal reads (by way of assimp): those that stand in one file, known by their first bytes.

assimp guesses formats from content whatever a file is called, and some of them (glTF) read any file as data.
"""

from __future__ import annotations

import json
from pathlib import Path

from mbocp._files import read_bytes
from mbocp.meshes.mesh_parts import MESH_LIMIT

_MAGIC = {
    ".ply": (b"ply",),
    ".off": (b"OFF", b"COFF", b"NOFF", b"STOFF"),
    ".3ds": (b"MM",),
    ".fbx": (b"Kaydara FBX", b"; FBX"),
    ".glb": (b"glTF",),
}
_GLB_HEADER = 20  # bytes before the JSON: magic, version, length; length and kind of the first chunk


def check_single_file(path: Path) -> None:
    """Check that a mesh is of a format that is read, and reads no other file.

    Raises
    ------
    Unreadable, ValueError
        If it is not.
    """
    suffix = path.suffix.lower()
    if suffix not in _MAGIC:
        known = ", ".join((".stl", ".dae", ".obj", *_MAGIC))
        raise ValueError(f"its format is not shown; convert it to one of {known}")
    content = read_bytes(path, expected="a mesh", limit=MESH_LIMIT)
    if not content.startswith(_MAGIC[suffix]):
        raise ValueError(f"is no {suffix} file")
    if suffix == ".glb" and _has_other_files(content):
        raise ValueError("keeps its data in other files; pack them into one .glb")


def _has_other_files(content: bytes) -> bool:
    length = int.from_bytes(content[12:16], "little")
    try:
        scene = json.loads(content[_GLB_HEADER : _GLB_HEADER + length])
        return any("uri" in buffer for buffer in scene.get("buffers", []))
    except (ValueError, RecursionError, AttributeError, TypeError) as error:
        raise ValueError("its JSON is broken") from error
