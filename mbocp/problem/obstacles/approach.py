"""The nearest approach of a motion to obstacles, and of links to each other, between nodes, too.

The motion is sampled at a thousand poses a second, on cubics through its nodes with their velocities. Spheres
say at once how near a link can be at most; where that may be nearer than what has been found, coal computes
the distance of the link's own shapes. At other poses these are not nearer by more than their points have
moved until then.
"""

from __future__ import annotations

from dataclasses import field, replace

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.problem.obstacles.clearance import Clearance, LinkPair
from mbocp.problem.obstacles.shape_distances import ShapeDistances
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.robot.model import RobotModel
from mbocp.robot.nodes import along

_RATE = 1000.0  # poses a second
_MOST = 50_000  # poses
_NEARS = (0.02, 0.1, 0.4, np.inf)  # [m]: farther spheres are only looked at where nothing is as near
_ALIKE = 8  # poses on either side of one in which shapes are in each other: not looked at ...
_ALIKE_MESHES = 100  # ... where both are meshes, which say little more than that they touch
_ITERATED = 1e-6  # [m] by which distances of shapes may be wrong: the tolerance of coal's iterations


@dataclass(frozen=True)
class Approach:
    """Where two things come nearest, beyond what is to be kept between them.

    Attributes
    ----------
    distance : float
        Of their shapes [m]; how deep they are in each other where it is negative.
    margin : float
        What was to be kept [m].
    link, other : str
        Link, and obstacle or other link.
    time : float
        [s].
    """

    distance: float
    margin: float
    link: str
    other: str
    time: float

    @property
    def between(self) -> str:
        """Both names."""
        return f"{self.link} and {self.other}"

    @property
    def words(self) -> str:
        """In a sentence."""
        if self.distance < 0.0:
            how = f"is {-1e3 * self.distance:.3g} mm inside {self.other}"
        else:
            how = f"is {1e3 * self.distance:.3g} mm from {self.other}"
        return f"{self.link} {how} at t = {self.time:.4g} s"


def nearest_approach(clearance: Clearance, t: Array, qs: Array, vs: Array | None = None) -> Approach | None:
    """Where a pair comes nearest to its margin, of all that are kept apart; None where there are none.

    Parameters
    ----------
    clearance : Clearance
    t : ndarray, shape (N + 1,)
        Times of the nodes [s].
    qs : ndarray, shape (N + 1, nq)
    vs : ndarray, shape (N + 1, nv), optional
        Of the cubics between the nodes; without, geodesics lead from node to node.
    """
    if not clearance.rows or not _goes_on(t, qs):
        return None
    for near in _NEARS:
        search = _Search.of(clearance, t, qs, vs, near)
        found = search.nearest(search.beyond)
        if found is not None:
            return found
    return None


def keeps_clear(clearance: Clearance, t: Array, qs: Array, tolerance: float, vs: Array | None = None) -> bool:
    """Whether no pair is nearer than its margin, or in each other, but for a tolerance [m].

    It takes a part of the time of `nearest_approach`, and says the same. The parameters are those.
    """
    if not clearance.rows or not _goes_on(t, qs):
        return True
    search = _Search.of(clearance, t, qs, vs, _farthest(clearance))
    lowered = np.maximum(search.margins, 0.0)
    search.bounds += (search.margins - lowered)[:, None]
    search.margins = lowered
    return search.nearest(-tolerance, is_any=True) is None


def touches_along(clearance: Clearance, t: Array, qs: Array, vs: Array | None = None) -> dict[str, Approach]:
    """Where things are deepest in each other, by `Approach.between`; nothing of what touches nothing.

    Parameters
    ----------
    clearance : Clearance
    t, qs, vs : ndarray, shapes (N + 1,), (N + 1, nq) and (N + 1, nv)
        As in `nearest_approach`.
    """
    found = dict[str, Approach]()
    if not clearance.rows or not _goes_on(t, qs):
        return found
    search = _Search.of(clearance, t, qs, vs, _farthest(clearance))
    for k in np.flatnonzero((search.bounds < -search.margins[:, None]).any(axis=1)):
        bounds, margins = search.bounds[[k]], search.margins[[k]]
        nearest = replace(search, pairs=[search.pairs[k]], bounds=bounds, margins=margins).nearest(
            -margins[0]
        )
        if nearest is not None:
            found[nearest.between] = nearest
    return found


def clearances_along(clearance: Clearance, t: Array, qs: Array) -> Array:
    """Smallest distance of all pairs that are kept apart, at each configuration, shape (n,) [m].

    Infinite without pairs, negative where shapes are in each other.

    Parameters
    ----------
    clearance : Clearance
    t, qs : ndarray, shapes (n,) and (n, nq)
    """
    found = np.full(len(qs), np.inf)
    for near in _NEARS:
        pairs, bounds, margins, beyond = _bounds(clearance, t, qs, near)
        shapes, bounds = ShapeDistances(clearance, pairs), bounds + margins[:, None]
        for n, q in enumerate(clearance.scene_configurations(qs, t)):
            shapes.place(q)
            for k in np.argsort(bounds[:, n]):
                if bounds[k, n] >= found[n]:
                    break
                found[n] = min(found[n], shapes.of(int(k)))
        if (found <= beyond).all():
            break
    return found


@dataclass(eq=False)
class _Search:
    """Pairs at the poses of a motion, by how near they may be.

    Attributes
    ----------
    clearance : Clearance
    times, places : ndarray, shapes (n,) and (n, any)
        Configurations of the scene, see `Clearance.scene_configurations`.
    pairs : list of (int, int, bool)
        A link, and an obstacle or another link.
    bounds : ndarray, shape (pairs, n)
        Distances beyond margins are not less, those that have not been looked at [m].
    margins : ndarray, shape (pairs,)
        [m].
    beyond : float
        All other pairs are farther away, beyond their margins [m].
    """

    clearance: Clearance
    times: Array
    places: Array
    pairs: list[LinkPair]
    bounds: Array
    margins: Array
    beyond: float
    _looked_at: Array = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # of poses
    _joints: Array = field(default_factory=lambda: np.zeros((0, 0, 3, 4)))  # placements there

    @classmethod
    def of(cls, clearance: Clearance, t: Array, qs: Array, vs: Array | None, near: float) -> _Search:
        """Of a motion. Pairs farther than `near` [m] may be taken for any that are."""
        times, sampled = poses_between(clearance.robot, t, qs, vs)
        placed = clearance.scene_configurations(sampled, times)
        return cls(clearance, times, placed, *_bounds(clearance, times, sampled, near))

    def nearest(self, most: float = np.inf, *, is_any: bool = False) -> Approach | None:
        """The smallest distance beyond its margin below `most` [m]; with `is_any` the first that is found."""
        shapes = ShapeDistances(self.clearance, self.pairs)
        best: tuple[int, int, float] | None = None  # pair, pose, distance
        least = self.bounds.min(axis=1)  # of each pair, of which a turn changes one
        while least.min(initial=np.inf) < most:
            k = int(least.argmin())
            n = int(self.bounds[k].argmin())
            shapes.place(self.places[n])
            distance = shapes.of(k)
            if distance - self.margins[k] < most:
                most, best = distance - float(self.margins[k]), (k, n, distance)
                if is_any:
                    break
            self.bounds[k, n] = np.inf
            if distance > 0.0:
                self._raise(n, k, distance, most, shapes)
            else:  # how deep shapes are may jump, and takes meshes twenty times as long as whether they touch
                alike = _ALIKE_MESHES if shapes.are_meshes(k) else _ALIKE
                self.bounds[k, max(n - alike, 0) : n + alike + 1] = np.inf
            least[k] = self.bounds[k].min()
        if best is None:
            return None
        k, n, distance = best if is_any else self._deepest(*best, shapes)
        names = self.clearance.names_of(self.pairs[k])
        return Approach(distance, float(self.margins[k]), *names, float(self.times[n]))

    def _deepest(self, k: int, n: int, distance: float, shapes: ShapeDistances) -> tuple[int, int, float]:
        """A pair, and the pose near by from which it only comes out, where it is in each other."""
        for step in (-1, 1):
            while distance <= 0.0 and 0 <= n + step < len(self.places):
                shapes.place(self.places[n + step])
                beside = shapes.of(k)
                if beside >= distance:
                    break
                n, distance = n + step, beside
        return k, n, distance

    def _raise(self, n: int, k: int, distance: float, most: float, shapes: ShapeDistances) -> None:
        """Raise bounds of a pair around a pose in which its distance is known."""
        if not self._looked_at.size:  # from now on they become fewer
            self._looked_at = np.union1d(np.flatnonzero((self.bounds < most).any(axis=0)), [n])
            self._joints = self.clearance.joint_placements(self.places[self._looked_at])
        others = np.flatnonzero(self.bounds[k] < most)
        here, there = np.searchsorted(self._looked_at, n), np.searchsorted(self._looked_at, others)
        moved = shapes.displacements(k, self._joints[here], self._joints[there])
        least = distance - moved - np.minimum(moved, _ITERATED)
        least = np.where(least > 0.0, least - self.margins[k], -np.inf)
        self.bounds[k, others] = np.maximum(self.bounds[k, others], least)


def _goes_on(t: Array, qs: Array) -> bool:
    """Whether a motion has poses: what a solver leaves behind that has failed may run backwards in time."""
    return bool(np.isfinite(qs).all() and t[-1] > t[0] and (np.diff(t) >= 0.0).all())


def poses_between(robot: RobotModel, t: Array, qs: Array, vs: Array | None = None) -> tuple[Array, Array]:
    """Times and configurations between the nodes, a thousand a second, and the nodes; see `along`."""
    t = np.asarray(t, dtype=np.float64)
    times = np.linspace(t[0], t[-1], min(int(np.ceil((t[-1] - t[0]) * _RATE)) + 1, _MOST))
    times = np.union1d(times, t)
    return times, along(robot, t, qs, vs, times)


def _bounds(
    clearance: Clearance, times: Array, qs: Array, near: float
) -> tuple[list[LinkPair], Array, Array, float]:
    """Pairs of a link and an obstacle or link; bounds of their distances beyond margins; their margins.

    Beyond what follows are all pairs that are not among these.
    """
    values = clearance.group_values(qs, near, times).T
    kept = np.flatnonzero((values < near).any(axis=1))
    pairs, gaps = [clearance.link_pairs[k] for k in kept], _gaps(clearance)
    left = [_gap_of(obstacle) for obstacle in clearance.obstacles]
    sticks = [gaps[a] + (left[b] if is_obstacle else gaps[b]) for a, b, is_obstacle in pairs]
    overlaps = np.zeros(len(values))
    np.maximum.at(overlaps, clearance.groups, clearance.overlaps)
    bounds = values[kept] - (np.array(sticks) + overlaps[kept])[:, None]
    margins = clearance.margins[np.unique(clearance.groups, return_index=True)[1][kept]]
    return pairs, bounds, margins, np.inf if len(kept) == len(values) else near - _farthest(clearance)


def _farthest(clearance: Clearance) -> float:
    """Spheres of things that touch, or are nearer than their margin, are nearer than this, beyond it [m]."""
    gaps, lowest = _gaps(clearance), min(float(clearance.margins.min()), 0.0)
    left = map(_gap_of, clearance.obstacles)
    return max(gaps) + max([*left, *gaps]) + float(clearance.overlaps.max()) - lowest + _ITERATED


def _gaps(clearance: Clearance) -> list[float]:
    """How far the shapes of each link are out of its spheres [m]."""
    return [0.0 if np.isnan(link.gap) else link.gap for link in clearance.robot.collision_spheres]


def _gap_of(obstacle: Obstacle) -> float:
    """How far an obstacle is out of the pieces that stand for it [m]."""
    return 0.0 if obstacle.compound is None else obstacle.compound.uncovered
