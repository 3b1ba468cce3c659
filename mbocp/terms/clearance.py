"""Clearance: spheres of a robot keep their distance from shapes, and from each other.

One term for all of them, so that the placement of each frame is computed once.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from mbocp.robot.collision.obstacle import SIZES
from mbocp.terms.distances import distance_between_points, signed_distance
from mbocp.terms.point import Point

__all__ = ["ClearanceTerm", "ShapeOn"]


@dataclass(frozen=True)
class ShapeOn:
    """The structure of an obstacle.

    Attributes
    ----------
    shape : str
        A key of `SIZES`.
    frame : int
        Index of the frame that carries it; 0: the world.
    """

    shape: str
    frame: int

    @property
    def sizes(self) -> dict[str, int]:
        """Size of each parameter: lengths, position and rotation by columns in its frame, smoothing."""
        return {"lengths": sum(SIZES[self.shape].values()), "position": 3, "rotation": 9, "smoothing": 1}


@dataclass(frozen=True)
class ClearanceTerm:
    """The structure of clearances: which spheres keep away from what.

    Attributes
    ----------
    frames : tuple of int
        Frame that carries each sphere.
    shapes : tuple of ShapeOn
    pairs : tuple of (int, int)
        A sphere and a shape.
    sphere_pairs : tuple of (int, int)
        Two spheres.
    """

    frames: tuple[int, ...]
    shapes: tuple[ShapeOn, ...]
    pairs: tuple[tuple[int, int], ...]
    sphere_pairs: tuple[tuple[int, int], ...] = ()

    has_velocity: ClassVar[bool] = False
    remembers: ClassVar[tuple[str, ...]] = ()

    @property
    def rows(self) -> int:
        """One for each pair."""
        return len(self.pairs) + len(self.sphere_pairs)

    @property
    def sizes(self) -> dict[str, int]:
        """Size of each parameter."""
        found = {"centers": 3 * len(self.frames)}
        for k, shape in enumerate(self.shapes):
            found |= {f"{k}.{name}": size for name, size in shape.sizes.items()}
        return found | ({"smoothing": 1} if self.sphere_pairs else {})

    @property
    def signature(self) -> dict[str, Any]:
        """What its function depends on."""
        return {"term": "clearance", **dataclasses.asdict(self)}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Distances of centres from shapes, then of centres from each other [m]."""
        placed = {
            frame: (at.mechanics.frame_rotation(frame, at.q), at.mechanics.frame_position(frame, at.q))
            for frame in {*self.frames, *(shape.frame for shape in self.shapes if shape.frame)}
        }
        centers = []
        for k, frame in enumerate(self.frames):
            R, origin = placed[frame]
            centers.append(origin + R @ p["centers"][3 * k : 3 * k + 3])
        rows = []
        for sphere, k in self.pairs:
            shape = self.shapes[k]
            point = centers[sphere]
            if shape.frame:
                R, origin = placed[shape.frame]
                point = R.T @ (point - origin)
            local = ca.reshape(p[f"{k}.rotation"], 3, 3).T @ (point - p[f"{k}.position"])
            rows.append(signed_distance(shape.shape, local, p[f"{k}.lengths"], p[f"{k}.smoothing"]))
        rows += [
            distance_between_points(centers[a], centers[b], p["smoothing"]) for a, b in self.sphere_pairs
        ]
        return ca.vertcat(*rows)
