"""Rods and springs between two frames: nodes whose place, direction and length follow the motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbocp._arrays import Array
from mbocp.view.meshcat.commands import Command, Track, colour_number, set_object, set_property, shape_object
from mbocp.view.meshcat.shapes import coil, tube
from mbocp.view.meshcat.viewer import mg
from mbocp.view.motion import Motion

if TYPE_CHECKING:
    from mbocp.robot import Connector

_LINE_RADIUS = 0.0015  # of the scene's size


def connector_commands(
    connectors: Sequence[Connector], motion: Motion, root: str, size: float
) -> tuple[list[Command], list[Track]]:
    """Draw and animate rods, springs and lines.

    Parameters
    ----------
    root : str
        Node of the scene.
    size : float
        Extent of the scene [m], which sets the thickness of lines.
    """
    commands: list[Command] = []
    tracks: list[Track] = []
    for index, connector in enumerate(connectors):
        path = f"{root}/connectors/{index}_{connector.kind}"
        start = motion.frame_positions(connector.frame_a)
        span = motion.frame_positions(connector.frame_b) - start
        lengths = np.linalg.norm(span, axis=1)
        usual = float(np.median(lengths)) or 1.0  # drawn at this length, so that stretching deforms it least
        stretch = np.ones((len(lengths), 3))
        stretch[:, 2] = np.maximum(lengths / usual, 1e-6)  # a scale of zero has no inverse
        values = {"position": start, "quaternion": directions(span, lengths), "scale": stretch}
        commands.append(set_object(path, _draw(connector, usual, size)))
        for name, value in values.items():
            commands.append(set_property(path, name, [float(x) for x in value[0]]))
            if np.ptp(value, axis=0).any():
                tracks.append(Track(path, name, motion.times, value))
    return commands, tracks


def _draw(connector: Connector, length: float, size: float) -> dict[str, Any]:
    if connector.kind == "spring":
        shape = coil(length, connector.radius)
    else:
        radius = _LINE_RADIUS * size if connector.kind == "line" else connector.radius
        shape = tube(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, length]]), radius, sides=16)
    *colour, opacity = connector.color
    return shape_object(shape, mg.MeshPhongMaterial(color=colour_number(colour), opacity=opacity))


def directions(span: Array, lengths: Array) -> Array:
    """Quaternions xyzw (F, 4) that turn +z along `span` (F, 3), each the nearest to the one before."""
    quaternions = np.empty((len(span), 4))
    direction, quaternion = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 0.0, 1.0])
    for i, (vector, length) in enumerate(zip(span, lengths, strict=True)):
        if length > 1e-9:
            quaternion = _compose(_between(direction, vector / length), quaternion)
            quaternion = quaternion / np.linalg.norm(quaternion)
            direction = vector / length
        quaternions[i] = quaternion
    return quaternions


def _between(a: Array, b: Array) -> Array:
    """Shortest rotation from unit vector a to unit vector b, quaternion xyzw."""
    w = 1.0 + float(a @ b)
    if w < 1e-12:  # opposite: half a turn about anything across
        axis = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))])
        return np.array([*(axis / np.linalg.norm(axis)), 0.0])
    quaternion = np.array([*np.cross(a, b), w])
    return np.asarray(quaternion / np.linalg.norm(quaternion))


def _compose(p: Array, q: Array) -> Array:
    """Quaternion product p q, xyzw."""
    return np.array([*(p[3] * q[:3] + q[3] * p[:3] + np.cross(p[:3], q[:3])), p[3] * q[3] - p[:3] @ q[:3]])
