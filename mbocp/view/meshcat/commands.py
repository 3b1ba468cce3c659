"""The few meshcat commands a replay sends, as the plain dictionaries that meshcat packs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from typing import Any

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.view.meshcat.viewer import SetObject, mg

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
