"""Where to look from: the camera that just holds every point the motion sweeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass

FIELD_OF_VIEW = 40.0  # [deg], vertical; the viewer's own 75 distorts
ASPECT = 1.5  # width over height that a fit assumes; the page adapts it to its window
# Share of the half picture that the motion may fill: to the sides, above (title) and below (playback bar).
FILL_SIDE, FILL_ABOVE, FILL_BELOW = 0.88, 0.80, 0.70
ELEVATION = np.deg2rad(18.0)
AZIMUTHS = np.deg2rad(np.arange(-75.0, 76.0, 15.0))  # from the front: robots face +x
USUAL_AZIMUTH = float(np.deg2rad(40.0))
_AROUND = np.deg2rad(np.arange(-180.0, 180.0, 15.0))
_HIDDEN = 0.2  # share of the motion behind obstacles from which on another side is looked for
_ASPECTS = np.geomspace(0.2, 5.0, 33)  # of windows, from a narrow phone to half of a wide screen
OBLIQUE = float(np.deg2rad(12.0))  # off the normal of a plane, so that depth can be seen


@dataclass(frozen=True)
class Camera:
    """A perspective camera that orbits `target`; z is up.

    Attributes
    ----------
    target : ndarray, shape (3,)
        The point it looks at [m].
    offset : ndarray, shape (3,)
        From the target to the camera [m], in a window of `ASPECT`.
    near, far : float
        Clipping distances [m].
    least : float
        Distance from the target that the height of the points needs in any window [m].
    sides : ndarray, shape (k, 2)
        Points that decide how far it steps back in narrow windows: how far they are aside of the target, over
        `FILL_SIDE` and the tangent of half the field of view, and before it [m].
    """

    target: Array
    offset: Array
    near: float
    far: float
    field_of_view: float = FIELD_OF_VIEW
    least: float = 0.0
    sides: Array = field(default_factory=lambda: np.zeros((0, 2)))

    def distance(self, aspect: float) -> float:
        """How far from the target it sees all points in a window, the page does the same [m]."""
        return float(np.max(self.sides[:, 0] / aspect + self.sides[:, 1], initial=self.least))


def upright(gravity: Array) -> Array:
    """Rotation (3, 3) that turns "against gravity" into +z; the identity without gravity."""
    size = float(np.linalg.norm(gravity))
    if size < 1e-9:
        return np.eye(3)
    up = -np.asarray(gravity, dtype=np.float64) / size
    return np.array(pin.Quaternion.FromTwoVectors(up, np.array([0.0, 0.0, 1.0])).matrix())


def fit_camera(
    points: Array,
    paths: Array,
    direction: tuple[float, float] | None = None,
    *,
    moving: Array | None = None,
    obstacles: Sequence[Array] = (),
) -> Camera:
    """Camera that holds all `points`, (M, 3), and sees `paths`, (K, 3), as broadside as it can [m].

    `direction`: azimuth and elevation from which it looks, instead [rad]. `moving`, (L, 3): what `obstacles`,
    the corners of each, are not to hide; by default `paths`.
    """
    azimuth, elevation = direction or (_azimuth(paths), ELEVATION)
    if direction is None:
        azimuth = _clear_azimuth(azimuth, paths, paths if moving is None else moving, obstacles)
    back, right, up = _axes(azimuth, elevation)
    tan_v = np.tan(np.deg2rad(FIELD_OF_VIEW) / 2.0)
    depth = points @ back
    side = FILL_SIDE * tan_v * ASPECT
    x, distance_x = _balance(points @ right, depth, side, side)
    y, distance_y = _balance(points @ up, depth, FILL_ABOVE * tan_v, FILL_BELOW * tan_v)
    # `distance` is measured along `back` from the origin's plane; the orbit's centre lies amid the points.
    middle = 0.5 * (depth.min() + depth.max())
    size = max(float(np.linalg.norm(np.ptp(points, axis=0))), 1e-3)
    distance = max(distance_x - middle, distance_y - middle, 0.2 * size)
    aside = np.abs(points @ right - x) / (FILL_SIDE * tan_v)
    return Camera(
        target=x * right + y * up + middle * back,
        offset=distance * back,
        near=1e-2 * size,
        far=float(100.0 * size + 10.0 * distance),
        least=max(distance_y - middle, 0.2 * size),
        sides=_extreme_points(np.column_stack([aside, depth - middle])),
    )


def _axes(azimuth: float, elevation: float) -> Array:
    """Unit vectors to the camera, to the right and up in its picture, shape (3, 3)."""
    flat = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    back = np.cos(elevation) * flat + np.array([0.0, 0.0, np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.array([back, right, np.cross(back, right)])


def _extreme_points(points: Array) -> Array:
    """Points that are the most aside and before the others in one window or another."""
    found = [np.argmax(points[:, 0] / aspect + points[:, 1]) for aspect in (*_ASPECTS, ASPECT)]
    return np.asarray(points[np.unique(found)])


def _balance(side: Array, depth: Array, over: float, under: float) -> tuple[float, float]:
    """Centre line and least camera depth D with -under (D - depth) <= side - centre <= over (D - depth)."""
    plus, minus = float(np.max(over * depth + side)), float(np.max(under * depth - side))
    distance = (plus + minus) / (over + under)
    return plus - over * distance, distance


def _azimuth(path: Array) -> float:
    """The usual view from the front and side, unless the path lies in an upright plane: then face it."""
    flat = path[:, :2] - path[:, :2].mean(axis=0)
    spread, axes = np.linalg.eigh(flat.T @ flat)
    height = float(np.sum((path[:, 2] - path[:, 2].mean()) ** 2))
    if spread[1] <= 1e-4 * height:  # upright: the same from all sides
        return USUAL_AZIMUTH
    if spread[0] > 0.02 * spread[1]:
        return _widest(flat)
    x, y = axes[:, 0] * np.sign(axes[:, 0] @ [np.cos(USUAL_AZIMUTH), np.sin(USUAL_AZIMUTH)])
    return float(np.arctan2(y, x)) + OBLIQUE


def _widest(flat: Array) -> float:
    """The azimuth from the front that sees most of the path, with a slight liking for the usual one."""
    return float(AZIMUTHS[int(np.argmax(_widths(flat, AZIMUTHS)))])


def _widths(flat: Array, azimuths: Array) -> Array:
    """How wide the path, (K, 2), is seen from each azimuth, times the liking."""
    widths = [np.std(-np.sin(a) * flat[:, 0] + np.cos(a) * flat[:, 1]) for a in azimuths]
    return np.array(widths) * (1.0 - 0.25 * np.abs(azimuths - USUAL_AZIMUTH) / np.pi)


def _clear_azimuth(usual: float, path: Array, moving: Array, obstacles: Sequence[Array]) -> float:
    """The usual azimuth, unless obstacles hide much of the motion from there: then the best of all around."""
    if _measure_hidden(usual, moving, obstacles) <= _HIDDEN:
        return usual
    seen = 1.0 - np.array([_measure_hidden(a, moving, obstacles) for a in _AROUND])
    return float(_AROUND[int(np.argmax(_widths(path[:, :2], _AROUND) * seen**2))])


def _measure_hidden(azimuth: float, moving: Array, obstacles: Sequence[Array]) -> float:
    """Share of the points that are behind the middle of an obstacle, in the rectangle that it fills."""
    axes = _axes(azimuth, ELEVATION)
    depth, *seen = axes @ moving.T
    is_hidden = np.zeros(len(moving), dtype=bool)
    for corners in obstacles:
        middle, *sides = axes @ corners.T
        within = [(side.min() <= x) & (x <= side.max()) for x, side in zip(seen, sides, strict=True)]
        is_hidden |= (depth < middle.mean()) & within[0] & within[1]
    return float(is_hidden.mean())
