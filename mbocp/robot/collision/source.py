"""Shapes of links as a robot's file says them, and what is said of spheres in robot.toml."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import coal
import pinocchio as pin

from mbocp._arrays import Array, dataclass


@dataclass(frozen=True)
class CollisionSphere:
    """A sphere that moves with a frame.

    Attributes
    ----------
    frame : str
    center : (float, float, float)
        In the frame [m].
    radius : float
        [m].
    """

    frame: str
    center: tuple[float, float, float]
    radius: float


class LinkShape(NamedTuple):
    """A shape of a link.

    Attributes
    ----------
    link : str
    number : int
        Among the shapes of the link.
    where : str
        What it is called in messages.
    geometry : coal.CollisionGeometry
        Empty for a mesh.
    mesh : str
        Path of the mesh; empty if it is none.
    scale : ndarray, shape (3,)
        Of the mesh.
    placement : pin.SE3
        In the link.
    """

    link: str
    number: int
    where: str
    geometry: coal.CollisionGeometry
    mesh: str
    scale: Array
    placement: pin.SE3


@dataclass(frozen=True, eq=False)
class ShapeSource:
    """What a robot's file says of the shapes of its links; solid ones are read when they are asked for.

    Attributes
    ----------
    path : Path
        The file, for messages.
    solid : callable
        Gives the shapes that links collide with; raises `RobotFileError`.
    disabled : callable
        Gives pairs of links that need not keep away from each other.
    drawn : frozenset of str
        Links with shapes to draw, missing ones included.
    prefix : str
        What stands before the names of its links among the robot's frames.
    """

    path: Path
    solid: Callable[[], Iterator[LinkShape]]
    disabled: Callable[[], frozenset[frozenset[str]]] = frozenset
    drawn: frozenset[str] = frozenset()
    prefix: str = ""

    def within(self, prefix: str) -> ShapeSource:
        """The same where names have one more prefix."""
        return replace(self, prefix=prefix + self.prefix)
