"""The self-contained page: meshcat's viewer, the scene, and a player, in one HTML file.

meshcat's own `static_html` needs a running server, repeats every mesh for every link that wears it, and hands
the commands over in no fixed order. Here the same commands go straight into the file: their structure as
JSON, and everything bulky (meshes, textures, key frames) once each, compressed, beside it.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import html
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._arrays import dataclass
from mbocp.exceptions import ReplayError
from mbocp.view.meshcat.commands import Ext, meshcat
from mbocp.view.meshcat.scene import FORCES, Scene

_MIN_SHARED_TEXT = 512  # characters; shorter strings stay in the JSON
_MIN_SHARED_LIST = 16  # numbers; a matrix stays in the JSON
_ARRAY_KIND = {0x12: "u1", 0x15: "i4", 0x16: "u4", 0x17: "f4"}  # meshcat's msgpack extensions


class _Store:
    """The bulky values of a scene: each is kept once, and the JSON refers to it by number."""

    def __init__(self) -> None:
        self.blobs: list[str] = []
        self._index: dict[bytes, int] = {}
        self._names: dict[str, str] = {}

    def lighten(self, value: Any) -> Any:
        """Copy a message, with references in place of bulky data."""
        if isinstance(value, Mapping):
            return {key: self.lighten(item) for key, item in value.items()}
        if isinstance(value, Ext):
            return self._reference(_ARRAY_KIND[value.type], value.data)
        if isinstance(value, str):
            return (
                self._reference("text", value.encode())
                if len(value) > _MIN_SHARED_TEXT
                else self._stable_name(value)
            )
        if isinstance(value, Sequence):
            if len(value) > _MIN_SHARED_LIST and all(isinstance(x, float) for x in value):
                return self._reference("f4", np.asarray(value, dtype="<f4").tobytes())
            return [self.lighten(item) for item in value]
        return value

    def _reference(self, kind: str, data: bytes) -> dict[str, Any]:
        key = hashlib.sha256(data).digest()
        if key not in self._index:
            self._index[key] = len(self.blobs)
            self.blobs.append(base64.b64encode(gzip.compress(data, 6, mtime=0)).decode("ascii"))
        return {"$blob": self._index[key], "kind": kind}

    def _stable_name(self, text: str) -> str:
        """Number meshcat's time-dependent uuids in order, so that equal scenes give equal files."""
        if len(text) == 36 and text.count("-") == 4:
            return self._names.setdefault(text, f"id{len(self._names)}")
        return text


@dataclass(frozen=True)
class Below:
    """What stands below the picture: HTML, more rules of style, and a script that runs after the player.

    The player tells its time by the event ``replaytime`` of the document, and follows ``replayjump``; both
    have the seconds since the motion's begin as their detail.
    """

    content: str
    style: str
    script: str


def render_page(
    scene: Scene, *, title: str, subtitle: str = "", speed: float = 1.0, below: Below | None = None
) -> str:
    """The whole page as text.

    Parameters
    ----------
    scene : Scene
    title, subtitle : str
        Shown above the picture.
    speed : float
        Seconds of motion per second at which the page starts to play.
    below : Below, optional
        What makes a report of it.
    """
    store = _Store()
    camera = scene.camera
    content = {
        "commands": [store.lighten(command.lower()) for command in scene.commands],
        "animation": store.lighten(scene.animation.lower()) if scene.animation else None,
        "duration": scene.duration,
        "speed": speed,
        "forces": {"path": FORCES, "words": scene.forces} if scene.forces else None,
        "camera": {
            "offset": [float(x) for x in camera.offset],
            "least": camera.least,
            "sides": [[float(x) for x in side] for side in camera.sides],
        },
    }
    parts = {
        "@TITLE@": html.escape(title),
        "@SUBTITLE@": html.escape(subtitle),
        "@MESHCAT@": _viewer_source(),
        "@SCENE@": json.dumps(content, separators=(",", ":")).replace("<", "\\u003c"),
        "@BLOBS@": "\n".join(store.blobs),
        "@PLAYER@": _resource("player.js"),
        "@STYLE@": below.style if below else "",
        "@BELOW@": f'<main id="below">{below.content}</main>' if below else "",
        "@SCRIPT@": f"<script>\n{below.script}</script>" if below else "",
    }
    page = _resource("page.html")
    pieces = re.split("(@[A-Z]+@)", page)
    return "".join(parts.get(piece, piece) for piece in pieces)


def _resource(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def _viewer_source() -> str:
    path = Path(meshcat.__file__).parent / "viewer" / "dist" / "main.min.js"
    try:
        source = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ReplayError(
            f"{path}: meshcat's viewer is missing; install meshcat again (pip install meshcat)"
        ) from error
    if "</script" in source.lower():
        raise ReplayError(f"{path}: this version of meshcat's viewer cannot be embedded in a page")
    return source
