"""Collada meshes: triangles, normals, texture coordinates, and the colour or picture of each surface.

meshcat's viewer can read Collada itself, but loses a mesh whose parts differ in their attributes (some
textured, some not: ANYmal) and parts with several materials, and takes exporters' muddled transparency at its
word; coal mixes up the triangles of files with several parts (UR5). Unit and up-axis are treated as in RViz,
where people check their URDF: the unit counts, the up-axis does not. (coal ignores both.)
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np

from mbocp._arrays import Array, norm
from mbocp._files import is_file, read_bytes
from mbocp._text import show
from mbocp.meshes.mesh_parts import MAX_TRIANGLES, MESH_LIMIT, Indices, MeshPart, Surface, distinct_rows, fans

Node = ElementTree.Element
_MAX_LEVELS = 64  # of nodes within each other
_MAX_ENTRY = 1e15  # entry of a placement whose determinant is finite
_MAX_NODES = 20_000  # each as often as others repeat it
_MAX_STRIDE = 1000


def read_collada(path: Path) -> tuple[MeshPart, ...]:
    """Read all triangles of a Collada file.

    Raises
    ------
    Unreadable, ElementTree.ParseError, ValueError, IndexError
        If the file cannot be read or refers to what it does not have.
    """
    content = read_bytes(path, expected="a Collada mesh", limit=MESH_LIMIT)
    try:
        root = ElementTree.fromstring(content)
    except LookupError as error:
        raise ValueError(f"{error}") from error  # unknown encoding
    for node in root.iter():
        node.tag = node.tag.rpartition("}")[2]
    return _Reader(root, path.parent).read()


class _Reader:
    """One document: its elements by id, and the walk through its scene."""

    def __init__(self, root: Node, folder: Path) -> None:
        self._root, self._folder = root, folder
        self._by_id = {node.get("id"): node for node in root.iter() if node.get("id")}
        self._sources: dict[str, Array] = {}
        self._triangles = self._visits = 0

    def read(self) -> tuple[MeshPart, ...]:
        scene = self._target(self._root.find("scene/instance_visual_scene"))
        if scene is None:
            scene = self._root.find("library_visual_scenes/visual_scene")
        if scene is None:
            raise ValueError("no scene in it")
        unit = self._root.find("asset/unit")
        scale = np.diag([*[1.0 if unit is None else float(unit.get("meter", "1"))] * 3, 1.0])
        return tuple(part for node in scene.findall("node") for part in self._node(node, scale, 1))

    def _target(self, reference: Node | None, key: str = "url") -> Node | None:
        return None if reference is None else self._by_id.get(reference.get(key, "").removeprefix("#"))

    def _node(self, node: Node, parent: Array, depth: int) -> Iterator[MeshPart]:
        self._visits += 1
        if depth > _MAX_LEVELS or self._visits > _MAX_NODES:
            raise ValueError(f"more than {_MAX_NODES} nodes, or {_MAX_LEVELS} within each other")
        placement = _product(parent, _transform(node))
        for instance in node.findall("instance_geometry"):
            yield from self._geometry(self._target(instance), instance, placement)
        for instance in node.findall("instance_controller"):  # a skin at rest is its mesh
            skin = self._target(instance)
            mesh = None if skin is None else self._target(skin.find("skin"), "source")
            yield from self._geometry(mesh, instance, placement)
        for instance in node.findall("instance_node"):
            other = self._target(instance)
            if other is not None:
                yield from self._node(other, placement, depth + 1)
        for child in node.findall("node"):
            yield from self._node(child, placement, depth + 1)

    def _geometry(self, geometry: Node | None, instance: Node, placement: Array) -> Iterator[MeshPart]:
        mesh = None if geometry is None else geometry.find("mesh")
        if mesh is None:
            return
        bound = {node.get("symbol"): node for node in instance.iter("instance_material")}
        for primitive in mesh:
            corners = _corners(primitive)
            if corners is None or len(corners) == 0:
                continue
            self._triangles += len(corners) // 3
            if self._triangles > MAX_TRIANGLES:
                raise ValueError(f"more than {MAX_TRIANGLES} triangles")
            symbol = primitive.get("material")
            material = self._target(bound.get(symbol), "target")
            if material is None and symbol:
                material = self._by_id.get(symbol)
            yield self._part(primitive, corners, placement, self._surface(material))

    def _part(self, primitive: Node, corners: Indices, placement: Array, surface: Surface | None) -> MeshPart:
        streams = dict(self._streams(primitive))
        names = [name for name in ("POSITION", "NORMAL", "TEXCOORD") if name in streams]
        if "POSITION" not in names:
            raise ValueError("a mesh without positions")
        used = corners[:, [streams[name][0] for name in names]]
        if used.min() < 0:
            raise ValueError("a corner has a negative number")
        rows, faces = distinct_rows(used)
        values = {name: streams[name][1][rows[:, k]] for k, name in enumerate(names)}
        if not (np.abs(placement) <= _MAX_ENTRY).all():  # NaN, too
            raise ValueError(f"a placement is not finite, or beyond {_MAX_ENTRY:g}")
        linear = placement[:3, :3]
        normals = values.get("NORMAL")
        if normals is not None:
            normals = normals[:, :3] @ np.linalg.inv(linear)
            normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        triangles = faces.reshape(-1, 3)
        if np.linalg.det(linear) < 0.0:
            triangles = triangles[:, ::-1]  # a mirror turns the triangles inside out
        vertices = values["POSITION"][:, :3] @ linear.T + placement[:3, 3]
        uvs = values["TEXCOORD"][:, :2] if "TEXCOORD" in values else None
        return MeshPart(vertices, triangles, normals, uvs, surface)

    def _streams(self, primitive: Node) -> Iterator[tuple[str, tuple[int, Array]]]:
        """Offset into the index tuples, and values, of each attribute; of several sets the first."""
        inputs = sorted(primitive.findall("input"), key=lambda node: -int(node.get("set", "0")))
        for node in inputs:
            offset, semantic = int(node.get("offset", "0")), node.get("semantic", "")
            if semantic == "VERTEX":
                vertices = self._target(node, "source")
                for inner in [] if vertices is None else vertices.findall("input"):
                    yield inner.get("semantic", ""), (offset, self._values(inner))
            elif semantic in ("NORMAL", "TEXCOORD"):
                yield semantic, (offset, self._values(node))

    def _values(self, reference: Node) -> Array:
        key = reference.get("source", "")
        if key not in self._sources:
            source = self._target(reference, "source")
            numbers = None if source is None else source.find("float_array")
            if source is None or numbers is None:
                raise ValueError(f"no data {show(key)} in it")
            accessor = source.find("technique_common/accessor")
            stride = int(accessor.get("stride", "1")) if accessor is not None else 3
            if not 1 <= stride <= _MAX_STRIDE:
                raise ValueError(f"data {show(key)} has a stride of {stride}")
            values = np.array((numbers.text or "").split(), dtype=np.float64)
            self._sources[key] = values[: len(values) // stride * stride].reshape(-1, stride)
        return self._sources[key]

    def _surface(self, material: Node | None) -> Surface | None:
        effect = None if material is None else self._target(material.find("instance_effect"))
        diffuse = None if effect is None else next(effect.iter("diffuse"), None)
        if effect is None or diffuse is None:
            return None
        colour = diffuse.find("color")
        if colour is not None:
            red, green, blue = (float(x) for x in (colour.text or "").split()[:3])
            return Surface((red, green, blue))
        texture = diffuse.find("texture")
        image = None if texture is None else self._image(effect, texture.get("texture", ""))
        return Surface((1.0, 1.0, 1.0) if image else (0.8, 0.8, 0.8), image)

    def _image(self, effect: Node, name: str) -> Path | None:
        """The file behind a sampler, a surface or an image; None if it is missing."""
        parameters = {node.get("sid"): node for node in effect.iter("newparam")}
        for tag in ("sampler2D/source", "surface/init_from"):
            parameter = parameters.get(name)
            inner = None if parameter is None else parameter.findtext(tag)
            name = name if inner is None else inner.strip()
        image = self._by_id.get(name)
        if image is None:
            return None
        text = image.findtext("init_from") or image.findtext("init_from/ref") or ""
        file = self._folder / unquote(re.sub(r"^file://", "", text.strip())).replace("\\", "/")
        return file if is_file(file) else None


def _integers(text: str | None) -> Indices:
    try:
        return np.array((text or "").split(), dtype=np.int64)
    except OverflowError as error:
        raise ValueError("an integer of more than 64 bits") from error


def _corners(primitive: Node) -> Indices | None:
    """Index tuples of the corners of all triangles, shape (3 F, inputs); None if it has no triangles."""
    inputs = primitive.findall("input")
    if primitive.tag not in ("triangles", "polylist", "polygons", "tristrips", "trifans") or not inputs:
        return None
    offsets = [int(node.get("offset", "0")) for node in inputs]
    if min(offsets) < 0:
        raise ValueError(f"a negative offset, {min(offsets)}")
    width = 1 + max(offsets)
    lists = [_integers(p.text).reshape(-1, width) for p in primitive.findall("p")]
    if not lists:
        return None
    if primitive.tag == "tristrips":
        return np.concatenate([tuples[_strip(len(tuples))] for tuples in lists])
    counts = np.array([len(tuples) for tuples in lists])
    if primitive.tag == "triangles":
        return np.concatenate(lists)
    if primitive.tag == "polylist":
        counts = _integers(primitive.findtext("vcount"))
    corners = np.concatenate(lists)
    return corners[fans(counts, len(corners))]


def _strip(count: int) -> Indices:
    k = np.arange(max(count - 2, 0))
    odd = k % 2
    return np.stack([k, k + 1 + odd, k + 2 - odd], axis=1).ravel().astype(np.int64)


def _transform(node: Node) -> Array:
    """Product of a node's transformations, in the order they are written, shape (4, 4)."""
    matrix = np.eye(4)
    for step in node:
        if step.tag not in ("matrix", "translate", "rotate", "scale"):
            continue
        numbers = np.array((step.text or "").split(), dtype=np.float64)
        local = np.eye(4)
        if step.tag == "matrix":
            local = numbers.reshape(4, 4)
        elif step.tag == "translate":
            local[:3, 3] = numbers
        elif step.tag == "scale":
            local[:3, :3] = np.diag(numbers)
        else:
            local[:3, :3] = _turn(numbers[:3], np.deg2rad(numbers[3]))
        matrix = _product(matrix, local)
    return matrix


def _product(first: Array, second: Array) -> Array:
    """Product of two placements; one that is not finite is refused where it is used."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(first @ second)


def _turn(axis: Array, angle: float) -> Array:
    x, y, z = axis / max(norm(axis), 1e-300)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)
