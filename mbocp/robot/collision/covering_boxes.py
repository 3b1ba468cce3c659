"""Clouds of points and height maps as obstacles: boxes along their axes that cover them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, IntArray, dataclass, frozen_array
from mbocp.exceptions import InvalidValue
from mbocp.meshes.mesh_parts import Indices
from mbocp.robot.collision.geometry import mesh_of
from mbocp.robot.collision.hull import Hull
from mbocp.robot.collision.solid import CORNERS

CLOUD, HEIGHTS = "cloud", "heights"
RESOLUTION = 0.02  # [m]
MAX_BOXES = 20_000
_MOST_CELLS = 250_000
_LONGEST = 64  # cells of a side of a box
_LARGEST = 1e6  # [m], and cubes from the origin
# Of a box with corners as `CORNERS` has them: seen counterclockwise from outside.
_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes that cover a cloud or the space below a height map, in its axes.

    Attributes
    ----------
    lows, highs : ndarray, shape (n, 3)
        Corners [m].
    keys : mapping of str to object
        What it is in a problem file.
    surface : tuple of ndarray
        Corners [m] and triangles of what is drawn, and looked at between nodes.
    words : str
        What the summary says of it.
    """

    lows: Array
    highs: Array
    keys: Mapping[str, Any]
    surface: tuple[Array, Indices]
    words: str

    uncovered: ClassVar[float] = 0.0  # boxes cover all of it

    @property
    def vertices(self) -> Array:
        """Corners of its surface, shape (V, 3) [m]."""
        return self.surface[0]

    @property
    def faces(self) -> Indices:
        """Triangles of its surface, shape (F, 3)."""
        return self.surface[1]

    @property
    def pieces(self) -> list[Hull | tuple[pin.SE3, Array]]:
        """Middles and axes, and sides [m]."""
        middles, sizes = (self.lows + self.highs) / 2.0, self.highs - self.lows
        return [(pin.SE3(np.eye(3), middle), size) for middle, size in zip(middles, sizes, strict=True)]

    @cached_property
    def shape(self) -> coal.BVHModelOBBRSS:
        """The surface, as coal has it."""
        return mesh_of(*self.surface)


def boxes_of_cloud(points: Array, resolution: float = RESOLUTION) -> Boxes:
    """Cubes that have points in them, joined to boxes.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        [m].
    resolution : float
        Side of a cube [m].

    Raises
    ------
    InvalidValue
        If there are none, too many, or they are not finite.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1:] != (3,) or not len(points):
        raise InvalidValue("points", f"an array of shape {points.shape}", "(n, 3) with n of 1 or more [m]")
    if not (np.abs(points) <= min(_LARGEST, _LARGEST * resolution)).all():  # NaN, too
        raise InvalidValue("points", "a coordinate that is not", f"finite, up to {_LARGEST:g} m, and cubes")
    cubes = np.unique(np.floor(points / resolution).astype(np.int64), axis=0)
    low, high = _join(cubes)
    _check_count(len(low), "resolution")
    lows, highs = (np.asarray(resolution * side, dtype=np.float64) for side in (low, high))
    words = f"{len(lows)} boxes of {len(cubes)} cubes of {1e3 * resolution:.3g} mm stand for its points"
    keys = {"points": (resolution * (cubes + 0.5)).tolist(), "resolution": resolution}
    return Boxes(frozen_array(lows), frozen_array(highs), keys, _surface_of_boxes(lows, highs), words)


def _join(cubes: IntArray) -> tuple[IntArray, IntArray]:
    """Boxes of cubes: rows along x, of these rectangles, of these boxes; first cubes, and those behind."""
    low, high = cubes, cubes + 1
    for axis in range(3):
        others = [k for k in (2, 1, 0) if k != axis]
        order = np.lexsort([low[:, axis], *(side[:, k] for k in others for side in (high, low))])
        low, high = low[order], high[order]
        is_same = (low[1:, others] == low[:-1, others]) & (high[1:, others] == high[:-1, others])
        goes_on = is_same.all(axis=1) & (low[1:, axis] == high[:-1, axis])
        first = np.flatnonzero(np.concatenate([[True], ~goes_on]))
        last = np.append(first[1:], len(low)) - 1
        low, high = low[first], np.where(np.arange(3) == axis, high[last], high[first])
    return low, high


def boxes_of_heights(heights: Array, cell: float, resolution: float = RESOLUTION) -> Boxes:
    """Boxes from below a map up to its highest place in each; cells of nearly the same height are one.

    Parameters
    ----------
    heights : ndarray, shape (m, n)
        Seen from above: from left to right along x, from above downwards against y; the middle is at x = y =
        0. NaN: there is nothing [m].
    cell : float
        From height to height along x and y [m].
    resolution : float
        By how much a box is higher than the highest place of a cell that is in it, at most [m].

    Raises
    ------
    InvalidValue
        If there are too few or too many heights, or too many boxes.
    """
    heights = np.asarray(heights, dtype=np.float64)
    if heights.ndim != 2 or min(heights.shape) < 2 or heights.size > _MOST_CELLS:
        expected = f"2 rows and columns or more, and {_MOST_CELLS} heights at most"
        raise InvalidValue("heights", f"an array of shape {heights.shape}", expected)
    if np.isinf(heights).any() or not np.abs(heights[~np.isnan(heights)]).max(initial=0.0) <= _LARGEST:
        raise InvalidValue("heights", "one that is too large", f"up to {_LARGEST:g} m")
    corners = np.stack([heights[a : a - 1 or None, b : b - 1 or None] for a in (0, 1) for b in (0, 1)])
    tops = corners.max(axis=0)
    is_cell = ~np.isnan(tops)
    if not is_cell.any():
        raise InvalidValue("heights", "no four of a cell", "numbers; nan is nothing")
    found = _rectangles(tops, is_cell, resolution)
    low = float(np.nanmin(heights)) - cell
    span = 0.5 * cell * np.array([heights.shape[1] - 1, heights.shape[0] - 1])
    lows, highs, out = np.empty((len(found), 3)), np.empty((len(found), 3)), 0.0
    for k, (i, j, rows, columns) in enumerate(found):
        top = float(tops[i : i + rows, j : j + columns].max())
        out = max(out, top - float(corners[:, i : i + rows, j : j + columns].min()))
        lows[k] = cell * j - span[0], span[1] - cell * (i + rows), low
        highs[k] = cell * (j + columns) - span[0], span[1] - cell * i, top
    words = f"{len(found)} boxes of {is_cell.sum()} cells are up to {1e3 * out:.3g} mm higher than it"
    keys = {"heights": heights.tolist(), "cell": cell, "resolution": resolution}
    surface = _surface_of_heights(heights, is_cell, cell, span, low)
    return Boxes(frozen_array(lows), frozen_array(highs), keys, surface, words)


def _rectangles(tops: Array, is_cell: BoolArray, most: float) -> list[tuple[int, int, int, int]]:
    """Rectangles of cells whose tops differ by `most` at most: first row and column, rows, columns."""
    left, found = is_cell.copy(), []
    for i, j in np.argwhere(is_cell).tolist():
        if not left[i, j]:
            continue
        row = tops[i, j : j + _LONGEST]
        spread = np.maximum.accumulate(row) - np.minimum.accumulate(row)
        fits = left[i, j : j + _LONGEST] & (np.nan_to_num(spread, nan=np.inf) <= most)
        columns = len(fits) if fits.all() else int(fits.argmin())
        block = tops[i : i + _LONGEST, j : j + columns]
        spread = np.maximum.accumulate(block.max(axis=1)) - np.minimum.accumulate(block.min(axis=1))
        fits = left[i : i + _LONGEST, j : j + columns].all(axis=1) & (
            np.nan_to_num(spread, nan=np.inf) <= most
        )
        rows = len(fits) if fits.all() else int(fits.argmin())
        left[i : i + rows, j : j + columns] = False
        found.append((i, j, rows, columns))
        _check_count(len(found), "resolution or cell")
    return found


def _check_count(count: int, key: str) -> None:
    if count > MAX_BOXES:
        raise InvalidValue("file", f"{count} boxes or more", f"up to {MAX_BOXES}; a larger {key} makes fewer")


def _surface_of_boxes(lows: Array, highs: Array) -> tuple[Array, Indices]:
    corners = np.where(CORNERS[None] > 0.0, highs[:, None], lows[:, None]).reshape(-1, 3)
    triangles = np.array([[(a, b, c), (a, c, d)] for a, b, c, d in _SIDES]).reshape(-1, 3)
    faces = (8 * np.arange(len(lows))[:, None, None] + triangles).reshape(-1, 3)
    return frozen_array(corners), faces


def _surface_of_heights(
    heights: Array, is_cell: BoolArray, cell: float, span: Array, low: float
) -> tuple[Array, Indices]:
    """Two triangles for each cell above and below, and sides where there is no further cell."""
    m, n = heights.shape
    x, y = np.meshgrid(cell * np.arange(n) - span[0], span[1] - cell * np.arange(m))
    z = np.nan_to_num(heights, nan=low)
    corners = np.vstack(
        [np.stack([x, y, side], axis=-1).reshape(-1, 3) for side in (z, np.full_like(z, low))]
    )
    i, j = np.nonzero(is_cell)
    around = [(i + 1) * n + j, (i + 1) * n + j + 1, i * n + j + 1, i * n + j]  # counterclockwise from above
    under = m * n
    squares = [np.stack(around, axis=1), np.stack(around[::-1], axis=1) + under]
    padded = np.pad(is_cell, 1)
    for k, (down, right) in enumerate(((1, 0), (0, 1), (-1, 0), (0, -1))):
        is_open = ~padded[i + 1 + down, j + 1 + right]
        first, second = around[k][is_open], around[(k + 1) % 4][is_open]
        squares.append(np.stack([second, first, first + under, second + under], axis=1))
    every = np.vstack(squares)
    return frozen_array(corners), np.vstack([every[:, [0, 1, 2]], every[:, [0, 2, 3]]])
