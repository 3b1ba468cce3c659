"""Heights of frames above a map, as path constraints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import casadi as ca
import numpy as np

from mbocp._arrays import dataclass
from mbocp._keys import Key
from mbocp.exceptions import ProblemError
from mbocp.robot import Robot
from mbocp.terms.path import PathNumbers, PathTerm, finite_bounds, one_bound
from mbocp.terms.point import Point
from mbocp.terms.surface import Surface, SurfaceKeys, SurfaceShape, surface_from
from mbocp.terms.written import Bound


@dataclass(frozen=True)
class Height(PathTerm):
    """Height of the frame's origin above a map.

    Attributes
    ----------
    map_rows, map_columns : int
        Of the map.
    """

    map_rows: int
    map_columns: int

    kind = "height"
    unit = "m"

    class Keys(SurfaceKeys):
        """Keys."""

        min: Annotated[Bound, Key("of a height above the map", "m", beside=("max",))] = None
        max: Bound = None

    @classmethod
    def of(cls, given: PathNumbers) -> Height:
        """With the size of the map."""
        return cls(given.frame, *_surface(given).size)

    @property
    def _shape(self) -> SurfaceShape:
        return SurfaceShape(self.map_rows, self.map_columns)

    @property
    def sizes(self) -> dict[str, int]:  # type: ignore[override]
        """Numbers of the map."""
        return self._shape.sizes

    @classmethod
    def check(cls, given: PathNumbers, key: str) -> None:
        """Nothing: what is no map was refused when it was made."""

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """The map and bounds."""
        surface = surface_from(given, key)
        if surface is None:
            raise ProblemError(f"{key}: above what? Give heights and cell")
        return {**surface._asdict(), **one_bound(given, key)}

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """The map and bounds."""
        return {**_surface(given).keys, **finite_bounds(given)}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Height [m]."""
        place = at.mechanics.frame_position(self.frame, at.q)
        return place[2] - self._shape.height(place, p)


def _surface(given: PathNumbers) -> Surface:
    return Surface(np.asarray(given.number("coefficients")), np.asarray(given.number("grid")))
