"""Where a robot's collision geometry comes from, and what is said of it in robot.toml."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from mbocp.robot.loading.urdf import Urdf


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


@dataclass(frozen=True, eq=False)
class CollisionSource:
    """A URDF whose <collision> elements are read when they are asked for.

    Attributes
    ----------
    urdf : Urdf
    folders : tuple of Path
        That hold packages of meshes.
    prefix : str
        What stands before the names of its links among the robot's frames.
    """

    urdf: Urdf
    folders: tuple[Path, ...] = ()
    prefix: str = ""

    def within(self, prefix: str) -> CollisionSource:
        """The same where names have one more prefix."""
        return replace(self, prefix=prefix + self.prefix)
