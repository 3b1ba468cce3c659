"""Reading a replay page back, and small robots to show."""

from __future__ import annotations

import base64
import gzip
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

_DTYPES = {"u1": "<u1", "i4": "<i4", "u4": "<u4", "f4": "<f4"}


@dataclass
class Page:
    """What a replay page contains."""

    text: str
    scene: dict[str, Any]
    blobs: list[bytes]

    def value(self, item: Any) -> Any:
        """Follow a reference to a bulky value."""
        if isinstance(item, dict) and "$blob" in item:
            data = self.blobs[item["$blob"]]
            return data.decode() if item["kind"] == "text" else np.frombuffer(data, _DTYPES[item["kind"]])
        return item

    def commands(self, kind: str, under: str = "/") -> dict[str, dict[str, Any]]:
        return {
            c["path"]: c for c in self.scene["commands"] if c["type"] == kind and c["path"].startswith(under)
        }

    def objects(self, under: str = "/replay/world") -> dict[str, dict[str, Any]]:
        return {path: c["object"] for path, c in self.commands("set_object", under).items()}

    def transform(self, path: str) -> np.ndarray:
        return np.array(self.commands("set_transform")[path]["matrix"]).reshape(4, 4).T

    def property(self, path: str, name: str) -> Any:
        found = [
            c["value"] for c in self.scene["commands"] if c.get("property") == name and c["path"] == path
        ]
        return found[-1]

    def tracks(self) -> dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]:
        """Key times and values by node and property."""
        found = {}
        for animation in self.scene["animation"]["animations"]:
            for track in animation["clip"]["tracks"]:
                times = np.array(self.value(track["times"]), dtype=float)
                values = np.array(self.value(track["values"]), dtype=float).reshape(len(times), -1)
                found[animation["path"], track["name"].removeprefix(".")] = (times, values)
        return found


def read_page(path: Path) -> Page:
    text = path.read_text(encoding="utf-8")
    scene = re.search(r'<script type="application/json" id="scene">(.*?)</script>', text, re.S)
    blobs = re.search(r'<script type="text/plain" id="blobs">\n(.*?)\n</script>', text, re.S)
    assert scene is not None
    assert blobs is not None
    packed = blobs.group(1).split("\n")
    return Page(text, json.loads(scene.group(1)), [gzip.decompress(base64.b64decode(b)) for b in packed if b])


def link(name: str, *visuals: str) -> str:
    """A link of 1 kg with visuals, each the inside of <geometry> and what follows it."""
    drawn = "".join(f"<visual>{visual}</visual>" for visual in visuals)
    inertia = '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>'
    return f'<link name="{name}"><inertial><mass value="1"/>{inertia}</inertial>{drawn}</link>'


def hinge(name: str, parent: str, child: str, xyz: str, kind: str = "continuous") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="0 1 0"/></joint>'
    )


def write_arm(folder: Path, *, base: str = "", upper: str = "", lower: str = "") -> Path:
    """A planar arm of two continuous hinges, links 1 m and 0.5 m long, with given visuals."""
    links = [link(n, *([v] if v else [])) for n, v in (("base", base), ("upper", upper), ("lower", lower))]
    joints = hinge("shoulder", "base", "upper", "0 0 0.2") + hinge("elbow", "upper", "lower", "0 0 1")
    tip = '<link name="tip"/>' + hinge("end", "lower", "tip", "0 0 0.5", kind="fixed")
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="arm">{"".join(links)}{joints}{tip}</robot>')
    return path


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 2\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


def stl(scale: float = 1.0) -> bytes:
    """A binary STL of one triangle."""
    corners = scale * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype="<f4")
    triangle = np.zeros(3, "<f4").tobytes() + corners.tobytes() + b"\0\0"
    return b"\0" * 80 + np.uint32(1).tobytes() + triangle


def angles(*hinges: float) -> list[float]:
    """Configuration of continuous hinges."""
    return [x for angle in hinges for x in (np.cos(angle), np.sin(angle))]
