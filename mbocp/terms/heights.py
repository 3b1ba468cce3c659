r"""Heights of a map: as a smooth surface, and of frames above it as path constraints.

.. math:: h(x, y) = \textstyle\sum_{ij} c_{ij} \, \beta(\eta - i) \, \beta(\xi - j), \qquad
    \beta(t) = \tfrac16 \textstyle\sum_{k=0}^4 (-1)^k \binom4k (t + 2 - k)_+^3

with :math:`\xi, \eta` in cells along x and against y. It is twice continuously differentiable; beyond its
edges the heights of these go on. The curvature across edges is zero.

References
----------
Unser, "Splines: a perfect fit for signal and image processing", 1999.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp._keys import Key, Table
from mbocp._text import show
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.robot import Robot
from mbocp.terms.path_term import PathNumbers, PathTerm, finite_bounds, one_bound
from mbocp.terms.point import Point
from mbocp.terms.written import Bound, Finite, Positive, Triple

MOST_HEIGHTS = 1024  # each is an operation of every function that sees them
_GRID = 6  # numbers of a grid


class HeightGrid(NamedTuple):
    """A map as numbers.

    Attributes
    ----------
    coefficients : ndarray, shape ((m + 2) (n + 2),)
        Of the spline, by columns [m].
    grid : ndarray, shape (6,)
        Where its first height is [m], its cell [m], and how many rows and columns it has.
    """

    coefficients: Array
    grid: Array

    @classmethod
    def through(cls, heights: Any, cell: float, middle: Any, key: str) -> HeightGrid:
        """Through heights, seen from above as an obstacle's are; `middle` is that of the map, at height 0.

        Raises
        ------
        InvalidValue
            If these are no rows of as many numbers, or too many.
        """
        is_table = len({len(row) for row in heights}) == 1
        table = np.array(heights if is_table else [[]], dtype=np.float64)
        m, n = table.shape
        if min(m, n) < 2 or m * n > MOST_HEIGHTS or not np.isfinite(table).all():
            expected = f"2 rows or more of as many finite numbers, up to {MOST_HEIGHTS} [m]; thin it out"
            raise InvalidValue(f"{key}: heights", show([list(row) for row in heights]), expected)
        x, y, z = middle
        first = (x - cell * (n - 1) / 2.0, y + cell * (m - 1) / 2.0, z)
        found = _solve(_solve(table).T).T
        return cls(found.ravel(order="F"), np.array([*first, cell, m, n], dtype=np.float64))

    @property
    def size(self) -> SurfaceShape:
        """Rows and columns."""
        m, n = self.grid[4:]
        return SurfaceShape(int(m), int(n))

    @property
    def keys(self) -> dict[str, Any]:
        """Keys that read back as the same."""
        m, n = self.size
        table = self.coefficients.reshape(n + 2, m + 2).T
        x, y, z, cell = self.grid[:4].tolist()
        heights = _stencil(m) @ table @ _stencil(n).T
        middle = [x + cell * (n - 1) / 2.0, y - cell * (m - 1) / 2.0, z]
        return {"heights": heights.tolist(), "cell": cell, "middle": middle}

    def at(self, points: Array) -> tuple[Array, Array]:
        """Heights [m] and slopes at points, shapes (k,) and (k, 2), of (k, 2) or more columns [m]."""
        p = ca.SX.sym("p", 2)
        height = height_at(p, ca.SX(self.coefficients), ca.SX(self.grid), self.size)
        function = ca.Function("surface", [p], [height, ca.gradient(height, p)]).map(len(points))
        heights, slopes = function(np.asarray(points)[:, :2].T)
        return np.asarray(heights).ravel(), np.asarray(slopes).T


def height_at(p: ca.SX, coefficients: ca.SX, grid: ca.SX, size: tuple[int, int]) -> ca.SX:
    """Height [m] of a surface of so many rows and columns below or above a point [m].

    Coefficients are chosen first, so that derivatives are those of one polynomial.
    """
    which_row, down = _cell((grid[1] - p[1]) / grid[3], size[0])
    which_column, across = _cell((p[0] - grid[0]) / grid[3], size[1])
    table = ca.reshape(coefficients, size[0] + 2, size[1] + 2)
    table = ca.horzcat(*(table[:, k : k + size[1] - 1] @ which_column for k in range(4)))
    table = ca.vertcat(*((table[k : k + size[0] - 1, :].T @ which_row).T for k in range(4)))
    return grid[2] + ca.dot(down, table @ across)


def _cell(u: ca.SX, count: int) -> tuple[ca.SX, ca.SX]:
    """In which cell a place from 0 to `count` - 1 is: 1 there, else 0; and weights of four coefficients."""
    u = ca.fmin(ca.fmax(u, 0.0), count - 1.0)
    begun = ca.vertcat(1, *(u >= k for k in range(1, count - 1)), 0)
    t = u - ca.sum1(begun[1:])
    rest = 1.0 - t
    inner = [4.0 + t * t * (3.0 * t - 6.0), 4.0 + rest * rest * (3.0 * rest - 6.0)]
    return begun[:-1] - begun[1:], ca.vertcat(rest * rest * rest, *inner, t * t * t) / 6.0


def _stencil(count: int) -> Array:
    """From coefficients to heights, shape (count, count + 2)."""
    return np.array([np.pad([1.0, 4.0, 1.0], (i, count - 1 - i)) for i in range(count)]) / 6.0


def _solve(heights: Array) -> Array:
    """Coefficients along the first axis, without curvature at both ends."""
    count = len(heights)
    ends = np.zeros((2, count + 2))
    ends[0, :3] = ends[1, -3:] = 1.0, -2.0, 1.0
    rows = np.vstack([ends[:1], _stencil(count), ends[1:]])
    return np.asarray(np.linalg.solve(rows, np.pad(heights, ((1, 1), (0, 0)))), dtype=np.float64)


class SurfaceKeys(Table):
    """Keys of a map."""

    heights: Annotated[
        list[list[Finite]] | None,
        Key(
            'of a `"height"` and of the ground below a contact: rows along x from the largest y on',
            "m",
            takes="list of lists",
        ),
    ] = None
    cell: Annotated[Positive | None, Key("from height to height", "m")] = None
    middle: Annotated[Triple, Key("of the map, at height 0", "m", "0")] = None


class SurfaceShape(NamedTuple):
    """Rows and columns of a map: all that expressions depend on."""

    rows: int
    columns: int

    @property
    def sizes(self) -> dict[str, int]:
        """Size of each parameter."""
        return {"coefficients": (self.rows + 2) * (self.columns + 2), "grid": _GRID}

    def height(self, place: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        """Of the map above or below a place [m]."""
        return height_at(place, p["coefficients"], p["grid"], self)

    def normal(self, place: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        """Of the map there, upwards: along z, x and y."""
        at = ca.SX.sym("at", 2)
        up = ca.vertcat(1, -ca.substitute(ca.gradient(self.height(at, p), at), at, place[:2]))
        return up / ca.sqrt(ca.sumsqr(up))


def surface_from(given: Mapping[str, Any], key: str) -> HeightGrid | None:
    """The map that keys say; None where they say none.

    Raises
    ------
    ProblemError, InvalidValue
        If something of it is missing, or cannot be right.
    """
    if given.get("heights") is None:
        for name in ("cell", "middle"):
            if given.get(name) is not None:
                raise ProblemError(f"{key}: {name}: of which map? Give heights, too")
        return None
    if given.get("cell") is None:
        raise ProblemError(f"{key}: heights: how far are they apart? Give cell [m]")
    return HeightGrid.through(given["heights"], given["cell"], given.get("middle") or [0.0] * 3, key)


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

        min: Annotated[Bound, Key("of a height", "m", beside=("max",))] = None
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


def _surface(given: PathNumbers) -> HeightGrid:
    return HeightGrid(np.asarray(given.number("coefficients")), np.asarray(given.number("grid")))
