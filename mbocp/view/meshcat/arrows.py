"""Nodes whose place, direction and length follow the motion: rods and springs between frames, and forces.

Forces are arrows at one scale for all. They are seen through bodies, as what is gripped hides the frame that
holds it: they are drawn last, without comparing depths, with their front faces alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp.robot import Connector
from mbocp.view.marks import ForceMark
from mbocp.view.meshcat.commands import Command, Track, animate, colour_number, mg, shape_object
from mbocp.view.meshcat.shapes import coil, cone, nice_length, tube
from mbocp.view.motion_samples import PlacementSamples

_LONGEST = 0.25  # of the scene's size
_SHAFT, _HEAD, _HEAD_LENGTH = 0.0035, 0.009, 0.03  # of the scene's size: radii, and length
_USUAL = 0.98  # quantile of sizes that is drawn at `_LONGEST` at most: a short peak may be longer
_NOTHING = 1e-6  # a scale of zero has no inverse
_COLOUR = (0.80, 0.10, 0.45)  # RGB
_CENTIMETRE = 0.01  # [m]
_DRAWN_LAST = 10  # renderOrder of three.js, where bodies have 0
_FRONT_FACES = 0  # of three.js
_LINE_RADIUS = 0.0015  # of the scene's size


@dataclass(frozen=True, eq=False)
class ForceArrows:
    """Arrows of a scene.

    Attributes
    ----------
    commands : list of Command
    tracks : list of Track
    words : str
        The scale, as "1 cm = 20 N"; empty where there are no arrows.
    """

    commands: list[Command]
    tracks: list[Track]
    words: str


def force_arrows(marks: Sequence[ForceMark], motion: PlacementSamples, root: str, size: float) -> ForceArrows:
    """Draw and animate forces.

    Parameters
    ----------
    marks : sequence of ForceMark
    motion : PlacementSamples
    root : str
        Node of all arrows.
    size : float
        Extent of the scene [m].
    """
    spans = [_forces(mark, motion) for mark in marks]
    sizes = [np.linalg.norm(span, axis=1) for span in spans]
    largest = max((float(np.quantile(length, _USUAL)) for length in sizes), default=0.0)
    if not (np.isfinite(largest) and largest > 0.0):
        return ForceArrows([], [], "")
    per_centimetre = 1.0 / nice_length(_LONGEST * size / (largest * _CENTIMETRE))
    found = ForceArrows([], [], f"1 cm = {per_centimetre:.3g} N")
    for index, (mark, span, newtons) in enumerate(zip(marks, spans, sizes, strict=True)):
        lengths = newtons * _CENTIMETRE / per_centimetre
        head = np.minimum(_HEAD_LENGTH * size, lengths / 2.0)
        start, turn = motion.frame_positions(mark.frame), directions(span, newtons)
        unit = span / np.maximum(newtons, 1e-300)[:, None]
        path = f"{root}/{index}_{mark.name.replace('/', '|')}"
        thick = np.maximum(np.minimum(lengths / (_HEAD_LENGTH * size), 1.0), _NOTHING)
        shaft = np.column_stack([thick, thick, np.maximum(lengths - head, _NOTHING)])
        tip = np.column_stack([thick, thick, np.maximum(head / (_HEAD_LENGTH * size), _NOTHING)])
        line = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        parts = [
            ("shaft", tube(line, _SHAFT * size, sides=12), start, shaft),
            ("head", cone(_HEAD * size, _HEAD_LENGTH * size), start + unit * (lengths - head)[:, None], tip),
        ]
        for name, shape, position, scale in parts:
            values = {"position": position, "quaternion": turn, "scale": scale}
            drawn, moved = animate(f"{path}/{name}", _draw(shape), values, motion.times)
            found.commands.extend(drawn)
            found.tracks.extend(moved)
    return found


def _draw(shape: mg.Geometry) -> dict[str, Any]:
    through = {"transparent": True, "depthTest": False, "depthWrite": False}  # after all that is opaque
    material = mg.MeshPhongMaterial(color=colour_number(_COLOUR), side=_FRONT_FACES, **through)
    drawn = shape_object(shape, material)
    drawn["object"]["renderOrder"] = _DRAWN_LAST
    return drawn


def _forces(mark: ForceMark, motion: PlacementSamples) -> Array:
    """Forces at the poses of a motion, in the world, shape (F, 3) [N]."""
    step = np.clip(np.searchsorted(mark.t, motion.times, side="right") - 1, 0, len(mark.forces) - 1)
    forces = mark.forces[step]
    if mark.is_along:
        way = motion.frame_positions(mark.frame) - motion.frame_positions(mark.other)
        return np.asarray(forces[:, :1] * way / np.maximum(np.linalg.norm(way, axis=1), 1e-12)[:, None])
    frame = motion.model.frames[mark.other]
    turned = motion.rotations[:, frame.parentJoint] @ frame.placement.rotation
    return np.asarray(np.einsum("fij,fj->fi", turned, forces))


def connector_commands(
    connectors: Sequence[Connector], motion: PlacementSamples, root: str, size: float
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
        drawn, moved = animate(path, _draw_connector(connector, usual, size), values, motion.times)
        commands += drawn
        tracks += moved
    return commands, tracks


def _draw_connector(connector: Connector, length: float, size: float) -> dict[str, Any]:
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
