"""A robot that is a part of a larger one: where it stands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mbocp._arrays import dataclass

SEPARATOR = "/"  # between the name of a part and those of its joints and frames


@dataclass(frozen=True)
class PlacedRobot:
    """One of several robots in a world; its joints and frames are called ``name/...``.

    Parameters
    ----------
    name : str
        What the part is called.
    robot : str
        Name of the robot.
    parent : str
        Frame that its base is fixed to; "world" stands still.
    position : (float, float, float)
        Of the base in that frame [m].
    orientation : (float, float, float, float)
        Of the base in that frame, unit quaternion xyzw.
    source : Path or None
        File that its model was read from.
    is_object : bool
        Whether it is a simple body, given by mass and shape.
    """

    name: str
    robot: str
    parent: str
    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float]
    source: Path | None = None
    is_object: bool = False

    @property
    def prefix(self) -> str:
        """What stands before the names of its joints and frames."""
        return self.name + SEPARATOR

    @property
    def table(self) -> dict[str, Any]:
        """What `mbocp.robot.describe` tells."""
        place = {"position": list(self.position), "orientation": list(self.orientation)}
        return {"name": self.name, "robot": self.robot, "parent": self.parent, **place}
