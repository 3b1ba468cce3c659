"""Wavefront OBJ meshes with their material files.

meshcat's viewer can read OBJ itself, but gives up on a file whose objects differ in their attributes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mbocp._arrays import Array
from mbocp._files import TEXT_LIMIT, is_file, read_bytes
from mbocp._text import shorten
from mbocp.meshes.mesh_parts import MESH_LIMIT, Indices, MeshPart, Surface, distinct_rows, fans

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
