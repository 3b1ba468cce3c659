"""Triangles of files: STL, OBJ, and what coal and the reader of Collada make of others.

Formats that coal reads (by way of assimp) stand in one file and are known by their first bytes: assimp
guesses formats from content whatever a file is called, and some of them (glTF) read any file as data.

meshcat's viewer can read OBJ itself, but gives up on a file whose objects differ in their attributes.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np

from mbocp._arrays import Array
from mbocp._files import TEXT_LIMIT, is_file, read_bytes
from mbocp._text import shorten
from mbocp.exceptions import Unreadable
from mbocp.meshes.collada import read_collada
from mbocp.meshes.mesh_parts import MESH_LIMIT, Indices, MeshPart, Surface, check_parts, distinct_rows, fans

_GREY = (0.8, 0.8, 0.8)
_MAX_LIBRARIES = 100  # material files of one mesh
_MAX_INDEX = 2**40


@dataclass
class _Faces:
    """Polygons with one material: number of corners of each, and the corners' three indices."""

    counts: list[int] = field(default_factory=list)
    corners: list[tuple[int, int, int]] = field(default_factory=list)  # -1: has none


def read_wavefront(path: Path) -> tuple[MeshPart, ...]:
    """Read all faces of an OBJ file.

    Raises
    ------
    Unreadable, ValueError, IndexError
        If the file cannot be read or refers to what it does not have.
    """
    values: dict[str, list[list[float]]] = {"v": [], "vn": [], "vt": []}
    groups: dict[str, _Faces] = {}
    libraries: dict[str, None] = {}
    material = ""
    text = _text(path, "an OBJ mesh", MESH_LIMIT).replace("\\\n", " ")
    for line in text.splitlines():
        word, _, rest = line.strip().partition(" ")
        if word in values:
            values[word].append([float(x) for x in rest.split()])
        elif word == "f":
            _add_face(groups.setdefault(material, _Faces()), rest.split(), values)
        elif word == "usemtl":
            material = rest.strip()
        elif word == "mtllib":
            libraries[rest.strip()] = None
    surfaces: dict[str, Surface] = {}
    for library in list(libraries)[:_MAX_LIBRARIES]:
        surfaces.update(_read_materials(path.parent / library))
    parts = tuple(_part(faces, values, surfaces.get(name)) for name, faces in groups.items())
    if not parts:
        raise ValueError("no faces in it")
    return parts


def _add_face(faces: _Faces, words: list[str], values: dict[str, list[list[float]]]) -> None:
    sizes = len(values["v"]), len(values["vt"]), len(values["vn"])
    faces.counts.append(len(words))
    for word in words:
        given = [int(text) if text else 0 for text in word.split("/")] + [0, 0]
        # Numbers count from one, negative ones back from the latest.
        v, vt, vn = (k - 1 if k >= 0 else size + k for k, size in zip(given, sizes, strict=False))
        if max(v, vt, vn) >= _MAX_INDEX or min(v, vt, vn) < -_MAX_INDEX:
            raise ValueError(f"a face refers to {shorten(word)}, which is not there")
        faces.corners.append((v, vt, vn))


def _part(faces: _Faces, values: dict[str, list[list[float]]], surface: Surface | None) -> MeshPart:
    corners = np.array(faces.corners, dtype=np.int64).reshape(-1, 3)
    corners = corners[fans(np.array(faces.counts, dtype=np.int64), len(corners))]
    rows, triangles = distinct_rows(corners)
    vertices = _take(values["v"], rows[:, 0], 3)
    if vertices is None:
        raise ValueError("a face without positions")
    normals, uvs = _take(values["vn"], rows[:, 2], 3), _take(values["vt"], rows[:, 1], 2)
    return MeshPart(vertices, triangles.reshape(-1, 3), normals, uvs, surface)


def _take(values: list[list[float]], rows: Indices, width: int) -> Array | None:
    """Rows of a list of numbers; None if some corner has none."""
    if not values or np.any(rows < 0):
        return None
    return np.array([values[k][:width] for k in rows], dtype=np.float64)


def _read_materials(path: Path) -> dict[str, Surface]:
    """Diffuse colours and pictures of a material file; nothing if it is missing."""
    if not is_file(path):
        return {}
    surfaces: dict[str, Surface] = {}
    name = ""
    for line in _text(path, "a material file", TEXT_LIMIT).splitlines():
        word, _, rest = line.strip().partition(" ")
        if word == "newmtl":
            name = rest.strip()
            surfaces[name] = Surface(_GREY)
        elif word == "Kd" and name:
            red, green, blue = (float(x) for x in rest.split()[:3])
            surfaces[name] = Surface((red, green, blue), surfaces[name].image)
        elif word == "map_Kd" and name and rest.strip():
            image = path.parent / rest.split()[-1]
            surfaces[name] = Surface((1.0, 1.0, 1.0), image) if is_file(image) else surfaces[name]
    return surfaces


def _text(path: Path, expected: str, limit: int) -> str:
    """A text of any encoding: only names can be other than ASCII."""
    return read_bytes(path, expected=expected, limit=limit).decode("utf-8", errors="replace")


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
