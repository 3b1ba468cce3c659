"""Points of clouds and heights of maps, from the files that have them."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from mbocp._arrays import Array
from mbocp._files import read_bytes
from mbocp._text import reads_as_number
from mbocp.exceptions import Unreadable
from mbocp.meshes.mesh_parts import MESH_LIMIT

_PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_PLY_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
_AXES = ("x", "y", "z")


def read_points(path: Path) -> Array:
    """Points of a cloud in the unit of its file, shape (n, 3); those that are not finite are left out.

    Raises
    ------
    Unreadable
        If it cannot be read, or has no points.
    """
    found = _read(path, "a cloud", {".ply": _ply, ".pcd": _pcd, ".npy": _npy, ".xyz": _text, ".csv": _text})
    if found.ndim != 2 or found.shape[1] < 3:
        raise Unreadable(f"has an array of shape {found.shape}, expected x, y and z of n points")
    points = found[np.isfinite(found[:, :3]).all(axis=1), :3]
    if not len(points):
        raise Unreadable("has no points")
    return points


def read_heights(path: Path) -> Array:
    """Heights of a map in the unit of its file, shape (rows, columns); NaN where there are none.

    Raises
    ------
    Unreadable
        If it cannot be read, or has no rows and columns.
    """
    readers = {".npy": _npy, ".csv": _text, ".png": _picture, ".tif": _picture, ".tiff": _picture}
    found = _read(path, "a height map", readers)
    if found.ndim != 2:
        raise Unreadable(f"has an array of shape {found.shape}, expected rows and columns, of one channel")
    return found


def _read(path: Path, what: str, readers: Mapping[str, Callable[[bytes], Array]]) -> Array:
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise Unreadable(f"is of no format that is read: {', '.join(readers)}")
    content = read_bytes(path, expected=what, limit=MESH_LIMIT)
    try:
        return np.asarray(reader(content), dtype=np.float64)
    except (ValueError, KeyError, IndexError, TypeError, OSError, EOFError, SyntaxError) as error:
        raise Unreadable(f"is no {path.suffix} file of {what}, or cut off ({error})") from error


def _npy(content: bytes) -> Array:
    return np.asarray(np.load(io.BytesIO(content), allow_pickle=False))


def _picture(content: bytes) -> Array:
    from PIL import Image  # wanted only here

    try:
        with Image.open(io.BytesIO(content)) as picture:
            return np.asarray(picture)
    except Image.DecompressionBombError as error:
        raise ValueError(str(error)) from error


def _text(content: bytes) -> Array:
    """Numbers in lines, between commas or spaces; lines that begin with a word or # are left out."""
    rows = [line.replace(",", " ").replace(";", " ").split() for line in content.decode().splitlines()]
    return np.array([[float(word) for word in row] for row in rows if row and reads_as_number(row[0])])


def _header(content: bytes, end: bytes) -> tuple[list[list[str]], bytes]:
    """Words of the lines of a header up to one that begins with `end`, and what follows."""
    at = content.index(b"\n" + end) + 1
    last = content.index(b"\n", at)
    lines = content[:last].decode("ascii").splitlines()
    return [line.split() for line in lines if line.strip() and not line.startswith("#")], content[last + 1 :]


def _ply(content: bytes) -> Array:
    """Corners of a PLY file, which come first in it."""
    lines, body = _header(content, b"end_header")
    order = next(words[1] for words in lines if words[0] == "format")
    counts = [(k, words) for k, words in enumerate(lines) if words[0] == "element"]
    first, (_, name, count) = counts[0]
    last = counts[1][0] if len(counts) > 1 else len(lines)
    fields = [
        (words[-1], _PLY_TYPES[words[1]]) for words in lines[first + 1 : last] if words[0] == "property"
    ]
    if name != "vertex":
        raise ValueError("vertices do not come first")
    return _table(body, fields, int(count), _PLY_ORDERS.get(order))


def _pcd(content: bytes) -> Array:
    lines, body = _header(content, b"DATA")
    words = {key: values for key, *values in lines}
    counts = [int(count) for count in words.get("COUNT", ["1"] * len(words["FIELDS"]))]
    kinds = [f"{kind.lower()}{size}" for kind, size in zip(words["TYPE"], words["SIZE"], strict=True)]
    fields = [
        (f"{name}/{k}" if k else name, kind)
        for name, kind, count in zip(words["FIELDS"], kinds, counts, strict=True)
        for k in range(count)
    ]
    (kind,) = words["DATA"]
    if kind == "binary_compressed":
        raise ValueError("it is compressed; write it with DATA binary: pcl_convert_pcd_ascii_binary")
    return _table(body, fields, int(words["POINTS"][0]), {"binary": "<"}.get(kind))


def _table(body: bytes, fields: list[tuple[str, str]], count: int, order: str | None) -> Array:
    """Columns x, y and z of as many rows; as text without an order of bytes."""
    names = [name for name, _ in fields]
    if order is None:
        rows = [line.split() for line in body.splitlines() if line.strip()]
        if len(rows) < count:
            raise ValueError(f"{len(rows)} of {count} points")
        columns = [names.index(axis) for axis in _AXES]
        return np.array([[float(row[k]) for k in columns] for row in rows[:count]])
    kind = np.dtype([(n if n in _AXES else str(k), order + form) for k, (n, form) in enumerate(fields)])
    found = np.frombuffer(body, dtype=kind, count=count)
    return np.column_stack([found[axis].astype(np.float64) for axis in _AXES])
