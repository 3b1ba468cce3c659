"""Spheres and convex parts that were found before: kept beside compiled functions, for seconds of work."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.exceptions import CompilationError
from mbocp.meshes.triangles import triangles_of
from mbocp.programme.cache import find_entry, unseal, write_entry

_SOURCES = ("compound", "covering_spheres", "geometry", "solid", "spheres")  # that say what is found

Arrays = Mapping[str, Array]


def load_or_fit(
    shapes: Sequence[pin.GeometryObject], numbers: Sequence[Array], fit: Callable[[], Arrays]
) -> Arrays:
    """Return what `fit` gives for shapes and numbers, from the folder where it is there.

    Parameters
    ----------
    shapes : sequence of pinocchio.GeometryObject
    numbers : sequence of ndarray
        All else that it depends on.
    fit : callable
        () -> arrays by name.
    """
    name = f"{_digest(shapes, numbers)}.fit"
    try:
        file = find_entry(name)
        content = None if file is None else unseal(file)
    except CompilationError:  # there is no folder at all
        return fit()
    before = None if content is None else _read(content)
    if before is not None:
        return before
    found, body = fit(), io.BytesIO()
    arrays: dict[str, Any] = dict(found)
    np.savez(body, **arrays)
    write_entry(name, body.getvalue())
    return found


def _read(content: bytes) -> dict[str, Array] | None:
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except (ValueError, OSError, zipfile.BadZipFile):
        return None


def _digest(shapes: Sequence[pin.GeometryObject], numbers: Sequence[Array]) -> str:
    digest = hashlib.sha256(_sources())
    arrays = [array for shape in shapes for array in _numbers_of(shape)]
    for array in (*arrays, *numbers):
        digest.update(repr((array.shape, str(array.dtype))).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _numbers_of(shape: pin.GeometryObject) -> list[Any]:
    """What a shape is, and where."""
    geometry = shape.geometry
    kind = np.frombuffer(type(geometry).__name__.encode(), dtype=np.uint8)
    if isinstance(geometry, coal.BVHModelBase):
        sizes: list[Any] = list(triangles_of(geometry))
    elif isinstance(geometry, coal.Box):
        sizes = [np.asarray(geometry.halfSide)]
    else:
        sizes = [np.array([getattr(geometry, name, 0.0) for name in ("radius", "halfLength")])]
    return [kind, *sizes, np.asarray(shape.placement.homogeneous)]


@cache
def _sources() -> bytes:
    folder = Path(__file__).parent
    return b"".join((folder / f"{name}.py").read_bytes() for name in _SOURCES)
