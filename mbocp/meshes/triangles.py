"""A mesh of any format as triangles."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import Unreadable
from mbocp.meshes.collada import read_collada
from mbocp.meshes.formats import check_single_file
from mbocp.meshes.mesh_parts import Indices, check_parts
from mbocp.meshes.stl import read_stl
from mbocp.meshes.wavefront import read_wavefront

READERS = {".dae": read_collada, ".obj": read_wavefront, ".stl": read_stl}
UNREADABLE = (Unreadable, OSError, RuntimeError, ValueError, IndexError, KeyError, ElementTree.ParseError)


def read_triangles(path: Path) -> tuple[Array, Indices]:
    """Corners, shape (V, 3), in the mesh's own unit, and triangles, shape (F, 3), of a mesh file.

    Raises
    ------
    Unreadable, OSError, RuntimeError, ValueError, IndexError, KeyError, ElementTree.ParseError
        `UNREADABLE`: if the file is missing, too large, broken or of no format that is read.
    """
    suffix = path.suffix.lower()
    if suffix not in READERS:
        loaded = load_by_coal(path, np.ones(3))
        faces = [loaded.tri_indices(k) for k in range(loaded.num_tris)]
        corners = np.array([[face[0], face[1], face[2]] for face in faces], dtype=np.int64)
        return np.array(loaded.vertices(), dtype=np.float64), corners
    parts = check_parts(READERS[suffix](path))
    starts = np.concatenate([[0], np.cumsum([len(part.vertices) for part in parts])])
    faces = [part.faces + start for part, start in zip(parts, starts[:-1], strict=True)]
    return np.vstack([part.vertices for part in parts]), np.vstack(faces)


def load_by_coal(path: Path, scale: Array) -> coal.BVHModelBase:
    """A mesh of a format that coal reads, scaled; raises as `read_triangles` does."""
    check_single_file(path)
    loaded = coal.MeshLoader(coal.BV_AABB).load(str(path), np.array(scale))
    if loaded.num_tris == 0 or not np.isfinite(loaded.vertices()).all():
        raise ValueError("no triangles in it, or a corner is not finite")
    return loaded
