r"""Few spheres that cover a solid: clusters of its points, each in a small ball.

For k = 1, 2, ... spheres, points on the surface and inside are divided among k balls by turns of assignment
(each point to the nearest centre) and of fitting (each ball the smallest of its points), as in Lloyd's
algorithm for the k-centre problem. The first k at which no sphere sticks out of the solid by more than the
tolerance is taken; where none does, the fewest that are nearly as good as the best.

References
----------
Badoiu, Clarkson, "Smaller core-sets for balls", 2003: the ball of a cluster.
"""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.robot.collision.solid import Solid, directions, sequence

_POINTS = 1200  # to cover, on the surface and inside each
_TURNS = 10
_BALL_STEPS = 40
_DIRECTIONS = directions(200)
_NEARLY = 1.15  # times the best: fewer spheres are worth it


@dataclass(frozen=True, eq=False)
class Cover:
    """Spheres.

    Attributes
    ----------
    centers : ndarray, shape (k, 3)
        [m].
    radii : ndarray, shape (k,)
        [m].
    """

    centers: Array
    radii: Array

    def gaps(self, points: Array) -> Array:
        """How far points are outside all spheres, shape (M,) [m]; negative within."""
        return np.asarray(_depths(self.centers, self.radii, points).min(axis=1))

    def enlarge(self, points: Array) -> Cover:
        """With radii so large that all points are covered; each grows the sphere that it is nearest to."""
        depths = _depths(self.centers, self.radii, points)
        nearest = depths.argmin(axis=1)
        radii = self.radii.copy()
        np.maximum.at(radii, nearest, self.radii[nearest] + depths[np.arange(len(points)), nearest])
        return Cover(self.centers, radii)


def cover(solid: Solid, tolerance: float, most: int) -> Cover:
    """Spheres that cover a solid.

    Parameters
    ----------
    solid : Solid
    tolerance : float
        How far spheres may stick out [m].
    most : int
        Number of spheres.
    """
    inner = solid.inner
    points = np.vstack([_thin(solid.surface), _thin(inner) if len(inner) else inner])
    found: list[tuple[Cover, float]] = []
    for count in range(1, most + 1):
        made = _balls(points, count).enlarge(solid.surface)
        found.append((made, float(protrusions(made, solid).max())))
        if found[-1][1] <= tolerance:
            return made
    best = min(out for _, out in found)
    return next(made for made, out in found if out <= _NEARLY * best)


def protrusions(spheres: Cover, solid: Solid) -> Array:
    """How far each sphere sticks out of the solid, shape (k,) [m]."""
    around = spheres.centers[:, None] + spheres.radii[:, None, None] * _DIRECTIONS
    return np.asarray(solid.outside(around.reshape(-1, 3)).reshape(len(spheres.radii), -1).max(axis=1))


def _balls(points: Array, count: int) -> Cover:
    centers = _far_apart(points, count)
    best: Cover | None = None
    for _ in range(_TURNS):
        owner = np.linalg.norm(points[:, None] - centers, axis=2).argmin(axis=1)
        balls = [_ball(points[owner == k]) if (owner == k).any() else (centers[k], 0.0) for k in range(count)]
        made = Cover(np.array([c for c, _ in balls]), np.array([r for _, r in balls]))
        if best is None or made.radii.max() < best.radii.max():
            best = made
        if np.allclose(made.centers, centers, rtol=0.0, atol=1e-9):
            break
        centers = made.centers
    assert best is not None
    keep = best.radii > 0.0 if (best.radii > 0.0).any() else np.ones(len(best.radii), dtype=np.bool_)
    return Cover(best.centers[keep], best.radii[keep])


def _ball(points: Array) -> tuple[Array, float]:
    """Centre and radius of nearly the smallest ball of points."""
    center = (points.min(axis=0) + points.max(axis=0)) / 2.0
    best, radius = center, np.inf
    for step in range(1, _BALL_STEPS + 1):
        away = points - center
        squares = np.einsum("ij,ij->i", away, away)
        far = int(squares.argmax())
        if squares[far] < radius**2:
            best, radius = center, float(np.sqrt(squares[far]))
        center = center + (points[far] - center) / (step + 1.0)
    return best, radius


def _far_apart(points: Array, count: int) -> Array:
    """Points of which each is as far from those before as can be, shape (count, 3)."""
    chosen = [points[np.linalg.norm(points - points.mean(axis=0), axis=1).argmax()]]
    distances = np.full(len(points), np.inf)
    while len(chosen) < count:
        distances = np.minimum(distances, np.linalg.norm(points - chosen[-1], axis=1))
        chosen.append(points[distances.argmax()])
    return np.array(chosen)


def _thin(points: Array) -> Array:
    """At most `_POINTS` of the points, those of the bounding box's sides among them."""
    if len(points) <= _POINTS:
        return points
    picked = np.floor(sequence(_POINTS)[:, 0] * len(points)).astype(int)
    extreme = np.concatenate([points.argmin(axis=0), points.argmax(axis=0)])
    return points[np.unique(np.concatenate([extreme, picked]))]


def _depths(centers: Array, radii: Array, points: Array) -> Array:
    """Distance of each point from each sphere, shape (M, k) [m]; negative within."""
    return np.asarray(np.linalg.norm(points[:, None] - centers, axis=2) - radii)
