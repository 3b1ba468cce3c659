"""A mesh of any format as triangles.

Formats that coal reads (by way of assimp) stand in one file and are known by their first bytes: assimp
guesses formats from content whatever a file is called, and some of them (glTF) read any file as data.
"""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np

from mbocp._arrays import Array
from mbocp._files import read_bytes
from mbocp.exceptions import Unreadable
from mbocp.meshes.collada import read_collada
from mbocp.meshes.mesh_parts import MESH_LIMIT, Indices, check_parts
from mbocp.meshes.stl import read_stl
from mbocp.meshes.wavefront import read_wavefront

READERS = {".dae": read_collada, ".obj": read_wavefront, ".stl": read_stl}
UNREADABLE = (Unreadable, OSError, RuntimeError, ValueError, IndexError, KeyError, ElementTree.ParseError)
_MAGIC = {
    ".ply": (b"ply",),
    ".off": (b"OFF", b"COFF", b"NOFF", b"STOFF"),
    ".3ds": (b"MM",),
    ".fbx": (b"Kaydara FBX", b"; FBX"),
    ".glb": (b"glTF",),
}
_GLB_HEADER = 20  # bytes before the JSON: magic, version, length; length and kind of the first chunk


def read_triangles(path: Path) -> tuple[Array, Indices]:
    """Corners, shape (V, 3), in the mesh's own unit, and triangles, shape (F, 3), of a mesh file.

    Raises
    ------
    Unreadable, OSError, RuntimeError, ValueError, IndexError, KeyError, ElementTree.ParseError
        `UNREADABLE`: if the file is missing, too large, broken or of no format that is read.
    """
    suffix = path.suffix.lower()
    if suffix not in READERS:
        return triangles_of(load_by_coal(path, np.ones(3)))
    parts = check_parts(READERS[suffix](path))
    starts = np.concatenate([[0], np.cumsum([len(part.vertices) for part in parts])])
    faces = [part.faces + start for part, start in zip(parts, starts[:-1], strict=True)]
    return np.vstack([part.vertices for part in parts]), np.vstack(faces)


def triangles_of(mesh: coal.BVHModelBase) -> tuple[Array, Indices]:
    """Corners, shape (V, 3) [m], and triangles, shape (F, 3), of a mesh."""
    corners = [mesh.tri_indices(k) for k in range(mesh.num_tris)]
    faces = np.array([[corner[0], corner[1], corner[2]] for corner in corners], dtype=np.int64)
    return np.array(mesh.vertices(), dtype=np.float64), faces


def load_by_coal(path: Path, scale: Array) -> coal.BVHModelBase:
    """A mesh of a format that coal reads, scaled; raises as `read_triangles` does."""
    check_single_file(path)
    loaded = coal.MeshLoader(coal.BV_AABB).load(str(path), np.array(scale))
    if loaded.num_tris == 0 or not np.isfinite(loaded.vertices()).all():
        raise ValueError("no triangles in it, or a corner is not finite")
    return loaded


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
