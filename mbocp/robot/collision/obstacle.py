"""Obstacles: shapes in the world or on a frame of a robot that its links keep away from."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp._quantities import is_number
from mbocp._text import show
from mbocp.exceptions import InvalidValue
from mbocp.robot import kinematics
from mbocp.robot.collision.compound import Compound
from mbocp.robot.collision.covering_boxes import CLOUD, HEIGHTS, Boxes
from mbocp.robot.collision.hull import Hull
from mbocp.robot.collision.obstacle_motion import ObstacleMotion

# Keys of a shape's sizes, and how many lengths each has.
SIZES: dict[str, dict[str, int]] = {
    "sphere": {"radius": 1},
    "capsule": {"radius": 1, "length": 1},
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "halfspace": {},
}
MESH = "mesh"  # the shape that has corners in the place of sizes
GRIDS = (CLOUD, HEIGHTS)  # those that boxes cover
SHAPES = (*SIZES, MESH, *GRIDS)
SMOOTHING = 2e-3  # [m] over which edges of shapes are rounded in the equations
_LATER = ("plane", "cone", "ellipsoid", "octree", "heightfield")
_LARGEST = 1e6  # [m]
_MIN_NORM = 1e-8


@dataclass(frozen=True, kw_only=True, eq=False)
class Obstacle:
    """A shape to keep away from.

    Parameters
    ----------
    name : str
    shape : {"sphere", "capsule", "box", "cylinder", "halfspace", "mesh", "cloud", "heights"}
        Capsules and cylinders are along z; a halfspace fills what is below z = 0; a mesh is a convex hull, or
        a compound of some.
    sizes : array_like
        In the order of `SIZES`: radius; radius and length (of a capsule without its ends); sides x, y, z
        [m]; of a halfspace and of a mesh nothing.
    position : array_like, shape (3,)
        Of the shape's centre in `frame` [m].
    orientation : array_like, shape (4,)
        Of its axes in those of `frame`, quaternion xyzw.
    frame : str
        Frame of the robot that carries it; "world" stands still.
    margin : float
        Least distance [m].
    smoothing : float
        Length over which edges are rounded in the equations [m].
    movable : bool
        Whether it is moved from one problem to the next: even what cannot reach it takes part, so that
        nothing compiles anew.
    hull : Hull, optional
        Of a mesh.
    compound : Compound or Boxes, optional
        Of a mesh that is not convex, in the place of its hull; of a cloud and a height map.
    motion : ObstacleMotion, optional
        Of a frame in the world that carries it.
    excess : float
        By how much its volume is larger than that of the file that it comes from, as a part of that; NaN
        where the file's surface is not closed.

    Raises
    ------
    InvalidValue
        If a value cannot be right.
    """

    name: str
    shape: str
    sizes: Array = ()  # type: ignore[assignment]  # made an array
    position: Array = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    orientation: Array = (0.0, 0.0, 0.0, 1.0)  # type: ignore[assignment]
    frame: str = kinematics.WORLD
    margin: float = 0.0
    smoothing: float = SMOOTHING
    movable: bool = False
    hull: Hull | None = None
    compound: Compound | Boxes | None = None
    excess: float = 0.0
    motion: ObstacleMotion | None = None

    def __post_init__(self) -> None:
        key = f"obstacle {self.name!r}"
        if self.shape in _LATER:
            expected = f"{' or '.join(SHAPES)}; cover other shapes by some of these"
            raise InvalidValue(f"{key}: shape", show(self.shape), expected)
        if self.shape not in SHAPES:
            raise InvalidValue.of_choice(f"{key}: shape", self.shape, SHAPES, "")
        bodies = sum(body is not None for body in (self.hull, self.compound))
        if bodies != (self.shape not in SIZES) or isinstance(self.compound, Boxes) != (self.shape in GRIDS):
            expected = "a hull or a compound of a mesh, boxes of a cloud or heights, nothing of other shapes"
            raise InvalidValue(f"{key}: hull and compound", f"{bodies} of them", expected)
        self._take("sizes", sum(SIZES.get(self.shape, {}).values()), "m")
        if np.any(np.asarray(self.sizes) <= 0.0):
            raise InvalidValue(f"{key}: sizes", np.asarray(self.sizes).tolist(), "lengths above 0 [m]")
        self._take("position", 3, "m")
        self._take("orientation", 4, "quaternion xyzw")
        norm = float(np.linalg.norm(self.orientation))
        if norm < _MIN_NORM:
            raise InvalidValue(f"{key}: orientation", np.asarray(self.orientation).tolist(), "a rotation")
        if abs(norm - 1.0) > 1e-15:
            object.__setattr__(self, "orientation", frozen_array(self.orientation / norm))
        for name, least in (("margin", -_LARGEST), ("smoothing", 1e-9)):
            value = getattr(self, name)
            if not (is_number(value) and least <= value <= _LARGEST):
                raise InvalidValue(f"{key}: {name}", show(value), f"a length from {least:g} on [m]")
            object.__setattr__(self, name, float(value))
        if not isinstance(self.movable, bool | np.bool_):
            raise InvalidValue(f"{key}: movable", show(self.movable), "true or false")
        self._check_carrier(key)

    @property
    def stands(self) -> bool:
        """Whether it is always at the same place of the world, and has an end."""
        return self.frame == kinematics.WORLD and self.motion is None and self.shape != "halfspace"

    @property
    def placement(self) -> pin.SE3:
        """Of the shape in its frame."""
        return pin.SE3(pin.Quaternion(np.array(self.orientation)).matrix(), np.array(self.position))

    @property
    def offset(self) -> pin.SE3:
        """Placement on what carries it: its frame, or the frame of its motion."""
        if self.motion is None or not self.motion.is_steady:
            return self.placement
        return pin.SE3(np.eye(3), -self.motion.positions[0]) * self.placement

    def placements(self, ts: Array) -> list[pin.SE3]:
        """In the world at some times, or in its frame where it has no motion."""
        if self.motion is None:
            return [self.placement] * len(ts)
        return [pin.XYZQUATToSE3(pose) * self.offset for pose in self.motion.poses(ts)]

    @property
    def geometry(self) -> coal.CollisionGeometry:
        """The shape, as coal has it."""
        body = self.hull or self.compound
        if body is not None:
            return body.shape
        sizes = [float(size) for size in self.sizes]
        if self.shape == "halfspace":
            return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
        made = {"sphere": coal.Sphere, "capsule": coal.Capsule, "box": coal.Box, "cylinder": coal.Cylinder}
        return made[self.shape](*sizes)

    @cached_property
    def pieces(self) -> tuple[Obstacle, ...]:
        """Convex obstacles that stand for it where solvers see it; what is a box is one."""
        if self.compound is None:
            return (self,)
        return tuple(self._piece(number, part) for number, part in enumerate(self.compound.pieces))

    def _piece(self, number: int, part: Hull | tuple[pin.SE3, Array]) -> Obstacle:
        name = f"{self.name}[{number}]"
        if isinstance(part, Hull):
            return replace(self, name=name, compound=None, hull=part)
        place = self.placement * part[0]
        placed = {"position": place.translation, "orientation": pin.Quaternion(place.rotation).coeffs()}
        return replace(self, name=name, shape="box", sizes=part[1], compound=None, **placed)

    @property
    def table(self) -> dict[str, Any]:
        """Keys and values as in a problem file."""
        found: dict[str, Any] = {"name": self.name, "shape": self.shape}
        at = 0
        if self.hull is not None:
            found["vertices"] = np.asarray(self.hull.vertices)
        if self.compound is not None:
            found |= self.compound.keys
        for key, count in SIZES.get(self.shape, {}).items():
            values = np.asarray(self.sizes)[at : at + count].tolist()
            found[key] = values[0] if count == 1 else values
            at += count
        found |= {"position": np.asarray(self.position), "orientation": np.asarray(self.orientation)}
        if self.motion is not None:
            found["motion"] = dict(self.motion.table)
        if self.frame != kinematics.WORLD:
            found["frame"] = self.frame
        found |= {"margin": self.margin, "smoothing": self.smoothing}
        return found | ({"movable": True} if self.movable else {})

    def _check_carrier(self, key: str) -> None:
        if self.motion is not None and self.frame != kinematics.WORLD:
            raise InvalidValue(f"{key}: frame", show(self.frame), "no frame: its motion is one in the world")

    def _take(self, name: str, count: int, unit: str) -> None:
        array = np.asarray(getattr(self, name), dtype=np.float64)
        if array.shape != (count,) or not np.all(np.abs(array) <= _LARGEST):
            expected = f"{count} numbers up to {_LARGEST:g} [{unit}]" if count else "nothing"
            raise InvalidValue(f"obstacle {self.name!r}: {name}", array.tolist(), expected)
        object.__setattr__(self, name, frozen_array(array))
