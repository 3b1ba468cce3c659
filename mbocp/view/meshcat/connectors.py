"""Rods and springs between two frames: nodes whose place, direction and length follow the motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot import Connector
from mbocp.view.meshcat.commands import Command, Track, animate, colour_number, shape_object
from mbocp.view.meshcat.shapes import coil, tube
from mbocp.view.meshcat.viewer import mg
from mbocp.view.motion import Motion

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
        drawn, moved = animate(path, _draw(connector, usual, size), values, motion.times)
        commands += drawn
        tracks += moved
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
    direction, turn = np.array([0.0, 0.0, 1.0]), pin.Quaternion.Identity()
    for i, (vector, length) in enumerate(zip(span, lengths, strict=True)):
        if length > 1e-9:
            turn = (pin.Quaternion.FromTwoVectors(direction, vector / length) * turn).normalized()
            direction = vector / length
        quaternions[i] = turn.coeffs()
    return quaternions
