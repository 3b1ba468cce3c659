"""The surroundings of the robot: background, floor, lights and the camera, all in proportion to the scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp.view.camera import Camera
from mbocp.view.meshcat.commands import Command, mg, set_object, set_property, set_transform, shape_object
from mbocp.view.meshcat.shapes import floor_disc, floor_lines, nice_length

BACKGROUND = (0.800, 0.835, 0.870)  # RGB
FLOOR = (0.905, 0.925, 0.940)
LINE = (0.66, 0.70, 0.74)
_REACH = 2.5  # radius of the floor in sizes of the scene
_MESHCAT_LIGHTS = ("PointLightNegativeX", "PointLightPositiveX", "FillLight")


def stage_commands(swept: Array, size: float, camera: Camera, root: str) -> list[Command]:
    """Commands that set the stage.

    Parameters
    ----------
    swept : ndarray, shape (M, 3)
        Points that the motion sweeps, z up [m].
    size : float
        Diagonal of their bounding box [m].
    camera : Camera
    root : str
        Node of the scene; it is moved so that the camera's target becomes the viewer's origin, which is what
        the mouse turns the picture about.
    """
    return [
        set_property("/Background", "top_color", list(BACKGROUND)),
        set_property("/Background", "bottom_color", list(BACKGROUND)),
        set_property("/Grid", "visible", False),
        set_property("/Axes", "visible", False),
        set_transform(root, np.eye(3), -camera.target),
        *_camera_commands(camera),
        *_light_commands(camera, size),
        *_floor_commands(swept, size, f"{root}/floor"),
    ]


def floor_height(swept: Array, size: float) -> float:
    """Zero if the motion is on the ground or not far above, else a little below the lowest point [m]."""
    low = float(swept[:, 2].min())
    return 0.0 if -0.02 * size <= low <= 0.6 * size else low - 0.05 * size


def _camera_commands(camera: Camera) -> list[Command]:
    eye = "/Cameras/default/rotated/<object>"
    x, y, z = (float(c) for c in camera.offset)
    return [
        set_property(eye, "fov", camera.field_of_view),
        set_property(eye, "near", camera.near),
        set_property(eye, "far", camera.far),
        set_property(eye, "position", [x, z, -y]),  # the camera's own node is y-up
    ]


def _light_commands(camera: Camera, size: float) -> list[Command]:
    back = camera.offset / np.linalg.norm(camera.offset)
    right = np.cross([0.0, 0.0, 1.0], back)
    key = 2.0 * size * (0.55 * back - 0.55 * right + [0.0, 0.0, 1.1])
    fill = 2.0 * size * (0.7 * back + right + [0.0, 0.0, 0.25])
    return [
        *(set_property(f"/Lights/{name}", "visible", False) for name in _MESHCAT_LIGHTS),
        set_property("/Lights/AmbientLight/<object>", "intensity", 0.55),
        set_object("/Lights/Key", _sun(key, 0.62, size)),
        set_object("/Lights/Fill", _sun(fill, 0.24)),
        set_property("/Lights/Fill/<object>", "castShadow", False),  # the viewer turns it on for all
    ]


def _sun(position: Array, intensity: float, shadow_size: float | None = None) -> dict[str, Any]:
    """A light from one direction towards the origin, as three.js's object format has it."""
    light: dict[str, Any] = {
        "uuid": mg.SceneElement().uuid,
        "type": "DirectionalLight",
        "color": 0xFFFFFF,
        "intensity": intensity,
        "matrix": [*np.eye(4).ravel()[:12].tolist(), *(float(x) for x in position), 1.0],  # by columns
    }
    if shadow_size is not None:
        half = 1.1 * shadow_size
        box = {
            "left": -half,
            "right": half,
            "top": half,
            "bottom": -half,
            "near": 0.01 * half,
            "far": 8.0 * half,
        }
        light["shadow"] = {
            "mapSize": [2048, 2048],
            "radius": 3.0,
            "normalBias": 0.002 * half,
            "camera": {"uuid": mg.SceneElement().uuid, "type": "OrthographicCamera", "zoom": 1.0, **box},
        }
    return {
        "metadata": {"version": 4.5, "type": "Object"},
        "geometries": [],
        "materials": [],
        "object": light,
    }


def _floor_commands(swept: Array, size: float, root: str) -> list[Command]:
    height = floor_height(swept, size)
    centre = np.array([*(0.5 * (swept.min(axis=0) + swept.max(axis=0)))[:2], height])
    reach, cell = _REACH * size, nice_length(size / 5.0)
    disc = floor_disc(centre - [0.0, 0.0, 1e-3 * size], reach, FLOOR, BACKGROUND)
    shadow = mg.Box([4.0 * size, 4.0 * size, 1e-6 * size])
    lines = floor_lines(centre, reach, cell, LINE, BACKGROUND)
    front = 0  # seen from above only, so that it never hides the robot
    return [
        set_object(f"{root}/disc", shape_object(disc, mg.MeshBasicMaterial(vertexColors=True, side=front))),
        set_object(
            f"{root}/lines", shape_object(lines, mg.LineBasicMaterial(vertexColors=True), mg.LineSegments)
        ),
        set_object(
            f"{root}/shadow",
            shape_object(shadow, _ShadowMaterial(opacity=0.16, transparent=True, side=front)),
        ),
        set_transform(f"{root}/shadow", np.eye(3), centre - [0.0, 0.0, 5e-4 * size]),
        *(
            set_property(f"{root}/{name}/<object>", "castShadow", False)
            for name in ("disc", "lines", "shadow")
        ),
    ]


class _ShadowMaterial(mg.GenericMaterial):  # type: ignore[misc]  # meshcat has no types
    """Shows nothing but the shadows on it."""

    _type = "ShadowMaterial"

    def __init__(self, **properties: Any) -> None:
        super().__init__(color=0x1F2933, **properties)
