"""meshcat, imported quietly, and the few of its commands a replay sends, as dictionaries that it packs.

Pinocchio imports all its viewers with one of them. Viser, and what it brings, takes a while
and is not for this. Nor is IPython, of which meshcat wants the name of one class, for cells of notebooks:
where IPython runs it has been imported before.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import field
from types import ModuleType
from typing import Any

import numpy as np

from mbocp._arrays import Array, dataclass


@contextmanager
def _replace_missing(modules: dict[str, ModuleType | None]) -> Iterator[None]:
    """Put others in the place of modules that have not been imported; None: it cannot be."""
    new = {name: module for name, module in modules.items() if name not in sys.modules}
    sys.modules.update(new)  # type: ignore[arg-type]  # None: it cannot be imported
    try:
        yield
    finally:
        for name in new:
            sys.modules.pop(name, None)


def _ipython() -> dict[str, ModuleType | None]:
    """IPython whose class that meshcat asks for is plain text; nothing where it has been imported."""
    if "IPython" in sys.modules:
        return {}
    display = ModuleType("IPython.display")
    display.HTML = str  # type: ignore[attr-defined]
    return {"IPython": ModuleType("IPython"), "IPython.display": display}


with warnings.catch_warnings(), _replace_missing({"viser": None, "trimesh": None, **_ipython()}):
    warnings.simplefilter("ignore", DeprecationWarning)
    import meshcat
    from meshcat import geometry as mg
    from meshcat.commands import SetObject
    from pinocchio.visualize import meshcat_visualizer

load_mesh = meshcat_visualizer.loadMesh
load_primitive = meshcat_visualizer.loadPrimitive
pack_array = mg.pack_numpy_array
Ext = mg.umsgpack.Ext  # binary data in a message

__all__ = ["Ext", "SetObject", "load_mesh", "load_primitive", "meshcat", "mg", "pack_array"]


FOREVER = 1_000_000_000  # repetitions; meshcat has no word for "without end"


@dataclass(frozen=True)
class Command:
    """One message to the viewer; meshcat's window takes anything that has `lower()`."""

    message: dict[str, Any] = field(repr=False)

    def lower(self) -> dict[str, Any]:
        """The message."""
        return self.message


@dataclass(frozen=True)
class Track:
    """One animated property of one node.

    Attributes
    ----------
    path : str
        Node.
    name : str
        "position", "quaternion" (xyzw) or "scale".
    times : ndarray, shape (F,)
        Key times [s].
    values : ndarray, shape (F, 3) or (F, 4)
        Key values.
    """

    path: str
    name: str
    times: Array
    values: Array

    def lower(self) -> dict[str, Any]:
        """The track as three.js reads it."""
        kind = "quaternion" if self.name == "quaternion" else "vector3"
        return {
            "name": f".{self.name}",
            "type": kind,
            "times": [float(x) for x in self.times],
            "values": [float(x) for x in np.ravel(self.values)],
        }


def set_object(path: str, drawn: dict[str, Any]) -> Command:
    """Draw an object (the dictionary of three.js's object format) at a node."""
    return Command({"type": "set_object", "path": path, "object": drawn})


def shape_object(
    geometry: mg.Geometry, material: mg.Material, kind: type[mg.Object] = mg.Mesh
) -> dict[str, Any]:
    """The object of a geometry and a material."""
    return dict(SetObject(kind(geometry, material)).lower()["object"])


def colour_number(rgb: Iterable[float]) -> int:
    """Red, green, blue in 0..1 as one number 0xRRGGBB."""
    red, green, blue = (round(255 * min(max(float(c), 0.0), 1.0)) for c in rgb)
    return (red << 16) + (green << 8) + blue


def set_transform(path: str, rotation: Array, translation: Array) -> Command:
    """Place a node in its parent."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    return Command({"type": "set_transform", "path": path, "matrix": [float(x) for x in matrix.T.ravel()]})


def set_property(path: str, name: str, value: Any) -> Command:
    """Set a property of a node."""
    return Command({"type": "set_property", "path": path, "property": name, "value": value})


def animate(
    path: str, drawn: dict[str, Any], values: Mapping[str, Array], times: Array
) -> tuple[list[Command], list[Track]]:
    """Draw an object at a node, whose properties have these values at these times [s], a row each."""
    commands = [set_object(path, drawn)]
    commands += [set_property(path, name, [float(x) for x in rows[0]]) for name, rows in values.items()]
    moving = ((name, rows) for name, rows in values.items() if np.ptp(rows, axis=0).any())
    return commands, [Track(path, name, times, rows) for name, rows in moving]


def set_animation(tracks: Iterable[Track], duration: float) -> Command:
    """Animate nodes; `duration` [s] may exceed the last key, which then holds until the loop starts again."""
    paths: dict[str, list[Track]] = {}
    for track in tracks:
        paths.setdefault(track.path, []).append(track)
    animations = [{"path": path, "clip": _clip(group, duration)} for path, group in paths.items()]
    options = {"play": True, "repetitions": FOREVER}
    return Command({"type": "set_animation", "path": "", "animations": animations, "options": options})


def _clip(tracks: Sequence[Track], duration: float) -> dict[str, Any]:
    # With fps = 1 key times are seconds, so nothing has to be rounded to frames.
    return {"fps": 1, "name": "replay", "duration": duration, "tracks": [track.lower() for track in tracks]}
