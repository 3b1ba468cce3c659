"""What a meshcat command draws, as triangles with one colour or a colour for each corner."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbocp._arrays import Array
from mbocp.exceptions import ReplayError

_TYPES = {"Float32Array": "<f4", "Uint32Array": "<u4", "Int32Array": "<i4", "Uint8Array": "u1"}
_STL_HEADER = 84  # [bytes]
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_SEGMENTS = 24  # of a round shape about its axis
_SUBDIVISIONS = 2  # of the icosahedron that stands for a ball


@dataclass(frozen=True, eq=False)
class Triangles:
    """A piece of a drawn object.

    Attributes
    ----------
    vertices : ndarray, shape (K, 3)
        Corners [m].
    faces : ndarray, shape (M, 3)
        Their numbers, three a triangle.
    colours : ndarray, shape (3,) or (K, 3)
        Red, green, blue from 0 to 1.
    opacity : float
        From 0 to 1.
    """

    vertices: Array
    faces: NDArray[np.int64]
    colours: Array
    opacity: float


def triangles_of(drawn: Mapping[str, Any]) -> Iterator[Triangles]:
    """Pieces of an object, one for each of its materials.

    Parameters
    ----------
    drawn : mapping
        As a `set_object` command carries it. Pictures on surfaces are left out, in favour of their colour.

    Raises
    ------
    ReplayError
        If it is neither triangles nor a box, ball or cylinder.
    """
    node = drawn["object"]
    geometry = next(g for g in drawn["geometries"] if g["uuid"] == node["geometry"])
    vertices, faces, colours = _corners(geometry)
    matrix = np.reshape(node.get("matrix", np.eye(4).ravel()), (4, 4)).T  # column by column
    vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    used = node["material"]
    listed = used if isinstance(used, list) else [used]
    materials = [next(m for m in drawn["materials"] if m["uuid"] == uuid) for uuid in listed]
    whole = [{"start": 0, "count": 3 * len(faces), "materialIndex": 0}]
    groups = geometry["data"].get("groups", whole) if isinstance(geometry.get("data"), Mapping) else whole
    for group in groups:
        material = materials[group["materialIndex"]]
        first = group["start"] // 3
        picked = faces[first : first + group["count"] // 3]
        corners, numbers = np.unique(picked, return_inverse=True)
        yield Triangles(
            vertices[corners],
            numbers.reshape(-1, 3),
            _rgb(material["color"]) if colours is None else colours[corners],
            float(material.get("opacity", 1.0)),
        )


def _corners(geometry: Mapping[str, Any]) -> tuple[Array, NDArray[np.int64], Array | None]:
    """Vertices, faces and colours of the vertices."""
    kind = geometry["type"]
    if kind == "BufferGeometry":
        attributes = geometry["data"]["attributes"]
        faces = _array(geometry["data"]["index"]).reshape(-1, 3).astype(np.int64)
        colours = _array(attributes["color"]) if "color" in attributes else None
        return _array(attributes["position"]), faces, colours
    if kind.startswith("_meshfile") and geometry.get("format") == "stl":
        content = np.frombuffer(geometry["data"].data, dtype=np.uint8)[_STL_HEADER:]
        vertices = content.view(_STL_TRIANGLE)["corners"].reshape(-1, 3).astype(np.float64)
        return vertices, np.arange(len(vertices)).reshape(-1, 3), None
    return *_primitive(kind, geometry), None


def _primitive(kind: str, sizes: Mapping[str, Any]) -> tuple[Array, NDArray[np.int64]]:
    from trimesh import creation

    if kind == "BoxGeometry":
        mesh = creation.box([sizes["width"], sizes["height"], sizes["depth"]])
        flat = np.array(mesh.vertices)[np.array(mesh.faces).ravel()]  # no corner in common: edges are seen
        return flat, np.arange(len(flat)).reshape(-1, 3)
    if kind == "SphereGeometry":
        mesh = creation.icosphere(subdivisions=_SUBDIVISIONS, radius=sizes["radius"])
    elif kind == "CylinderGeometry" and sizes["radiusTop"] == sizes["radiusBottom"]:
        mesh = creation.cylinder(sizes["radiusTop"], sizes["height"], sections=_SEGMENTS)
        vertices = np.array(mesh.vertices)[:, [1, 2, 0]]  # along y, as three.js has it
        return vertices, np.array(mesh.faces, dtype=np.int64)
    else:
        raise ReplayError(f"live view: a {kind} cannot be drawn")
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)


def _array(packed: Mapping[str, Any]) -> Array:
    """Numbers of an attribute, one row an item."""
    numbers = np.frombuffer(packed["array"].data, dtype=_TYPES[packed["type"]])
    return numbers.reshape(-1, packed["itemSize"]).astype(np.float64)


def _rgb(number: int) -> Array:
    return np.array([number >> 16 & 255, number >> 8 & 255, number & 255]) / 255.0
