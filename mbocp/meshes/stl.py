"""STL meshes, binary and as text: read whole, so that nothing but triangles gets into a page."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from mbocp._arrays import Array
from mbocp._files import read_bytes
from mbocp.meshes.mesh_parts import MESH_LIMIT, MeshPart

_HEADER, _COUNT = 80, 4  # [bytes]
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)


def read_stl(path: Path) -> tuple[MeshPart, ...]:
    """Read all triangles of an STL file.

    Raises
    ------
    Unreadable, ValueError
        If the file cannot be read, or is no STL file.
    """
    content = read_bytes(path, expected="an STL mesh", limit=MESH_LIMIT)
    count = int.from_bytes(content[_HEADER : _HEADER + _COUNT], "little")
    size = _HEADER + _COUNT + count * _TRIANGLE.itemsize
    is_text = content.lstrip()[:5].lower() == b"solid" and size != len(content)
    corners, normals = _read_text(content) if is_text else _read_binary(content, count, size)
    faces = np.arange(len(corners), dtype=np.int64).reshape(-1, 3)
    return (MeshPart(corners, faces, normals, None, None),)


def _read_binary(content: bytes, count: int, size: int) -> tuple[Array, Array]:
    if len(content) < _HEADER + _COUNT:
        raise ValueError("is no STL file: it is shorter than a header")
    if size > len(content):
        room = (len(content) - _HEADER - _COUNT) // _TRIANGLE.itemsize
        raise ValueError(f"is no STL file, or cut off: it declares {count} triangles and has room for {room}")
    triangles = np.frombuffer(content, _TRIANGLE, count, _HEADER + _COUNT)
    normals = np.repeat(triangles["normal"], 3, axis=0)
    with np.errstate(invalid="ignore"):  # the caller refuses numbers that are not finite
        return triangles["corners"].reshape(-1, 3).astype(np.float64), normals.astype(np.float64)


def _read_text(content: bytes) -> tuple[Array, None]:
    found = np.array(_VERTEX.findall(content), dtype=np.bytes_).reshape(-1, 3)
    if len(found) % 3:
        raise ValueError(f"is no STL file, or cut off: its {len(found)} corners are not three a triangle")
    return found.astype(np.float64), None


def binary_stl(part: MeshPart) -> bytes:
    """A binary STL of triangles, with an empty header and no attributes."""
    triangles = np.zeros(len(part.faces), _TRIANGLE)
    triangles["corners"] = corners = part.vertices[part.faces]
    if part.normals is None:
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        triangles["normal"] = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
    else:
        triangles["normal"] = part.normals[part.faces[:, 0]]
    header = b"\0" * _HEADER + len(triangles).to_bytes(_COUNT, "little")
    return header + triangles.tobytes()
