"""The nearest approach of a motion to obstacles, and of links to each other, between nodes, too.

The motion is sampled at a thousand poses a second, on geodesics from node to node. Spheres say at once how
near a link can be at most; where that may be nearer than what has been found, coal computes the distance of
the link's own shapes.
"""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.problem.clearance import Clearance
from mbocp.robot.large import working_data
from mbocp.robot.model import RobotModel
from mbocp.robot.nodes import between

__all__ = ["Approach", "nearest_approach", "poses_between"]

_RATE = 1000.0  # poses a second
_MOST = 50_000  # poses
_NEAR = 0.1  # [m]: farther spheres are only looked at where nothing is as near


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
    is_obstacle : bool
        Whether `other` is an obstacle.
    """

    distance: float
    margin: float
    link: str
    other: str
    time: float
    is_obstacle: bool

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


Shape = tuple[int, pin.SE3, coal.CollisionGeometry]  # a joint, where on it, and what


class _Distances:
    """Distances of links and obstacles by their own shapes, at one configuration after the other.

    Parameters
    ----------
    clearance : Clearance
    pairs : list of (int, int, bool)
        A link, and an obstacle or another link.
    """

    def __init__(self, clearance: Clearance, pairs: list[tuple[int, int, bool]]) -> None:
        self._model = clearance.robot.model
        self._data = working_data(self._model)
        self._geometry = pin.GeometryModel()
        self._first = [0]  # of the shapes of each pair
        numbers: dict[tuple[int, bool], list[int]] = {}
        for link, number, is_obstacle in pairs:
            for key in ((link, False), (number, is_obstacle)):
                if key not in numbers:
                    shapes = _obstacle(clearance, key[0]) if key[1] else _link(clearance, key[0])
                    numbers[key] = [self._add(shape) for shape in shapes]
            for one in numbers[link, False]:
                for other in numbers[number, is_obstacle]:
                    self._geometry.addCollisionPair(pin.CollisionPair(one, other))
            self._first.append(len(self._geometry.collisionPairs))
        self._placed = pin.GeometryData(self._geometry)

    def _add(self, shape: Shape) -> int:
        joint, placement, geometry = shape
        name = str(self._geometry.ngeoms)
        return int(self._geometry.addGeometryObject(pin.GeometryObject(name, joint, placement, geometry)))

    def place(self, q: Array) -> None:
        """Take a configuration, shape (nq,)."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._placed, q)

    def of(self, pair: int) -> float:
        """Of the nearest shapes of a pair, negative where they are in each other [m]."""
        shapes = range(self._first[pair], self._first[pair + 1])
        found = (pin.computeDistance(self._geometry, self._placed, k).min_distance for k in shapes)
        return float(min(found, default=np.inf))


def nearest_approach(clearance: Clearance, t: Array, qs: Array) -> Approach | None:
    """Smallest distance beyond its margin of all pairs that are kept apart; None where there are none.

    Parameters
    ----------
    clearance : Clearance
    t : ndarray, shape (N + 1,)
        Times of the nodes [s].
    qs : ndarray, shape (N + 1, nq)
    """
    if not clearance.rows or not np.isfinite(qs).all():
        return None
    times, sampled = poses_between(clearance.robot, t, qs)
    pairs, bounds, margins = _bounds(clearance, sampled)
    distances, at = _Distances(clearance, pairs), -1
    best: Approach | None = None
    for flat in np.argsort(bounds, axis=None, kind="stable"):
        n, k = divmod(int(flat), len(pairs))
        if best is not None and bounds[n, k] >= best.distance - best.margin:
            break
        if n != at:
            distances.place(sampled[n])
            at = n
        distance = distances.of(k)
        if best is None or distance - margins[k] < best.distance - best.margin:
            names = _names(clearance, pairs[k])
            best = Approach(distance, margins[k], *names, float(times[n]), pairs[k][2])
    return best


def poses_between(robot: RobotModel, t: Array, qs: Array) -> tuple[Array, Array]:
    """Times and configurations between the nodes, a thousand a second, and the nodes."""
    t = np.asarray(t, dtype=np.float64)
    times = np.linspace(t[0], t[-1], min(int(np.ceil((t[-1] - t[0]) * _RATE)) + 1, _MOST))
    times = np.union1d(times, t)
    step = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 2)
    shares = (times - t[step]) / (t[step + 1] - t[step])
    return times, between(robot, qs[step], qs[step + 1], shares)


def _bounds(clearance: Clearance, qs: Array) -> tuple[list[tuple[int, int, bool]], Array, list[float]]:
    """Pairs of a link and an obstacle or link; bounds of their distances beyond margins; their margins."""
    links = clearance.robot.collision_spheres
    gaps = [0.0 if np.isnan(link.gap) else link.gap for link in links]
    values = clearance.pair_values(qs, _NEAR) - clearance.margins
    rounding = max([o.smoothing for o in clearance.obstacles], default=0.0)
    columns: dict[tuple[int, int, bool], list[int]] = {}
    for row, (sphere, k) in enumerate(clearance.pairs):
        columns.setdefault((clearance.spheres[sphere][0], k, True), []).append(row)
    for row, (a, b) in enumerate(clearance.sphere_pairs, start=len(clearance.pairs)):
        columns.setdefault((clearance.spheres[a][0], clearance.spheres[b][0], False), []).append(row)
    pairs = list(columns)
    found = [
        values[:, rows].min(axis=1) - rounding - gaps[a] - (0.0 if is_obstacle else gaps[b])
        for (a, b, is_obstacle), rows in columns.items()
    ]
    return pairs, np.array(found).T, [float(clearance.margins[rows[0]]) for rows in columns.values()]


def _names(clearance: Clearance, pair: tuple[int, int, bool]) -> tuple[str, str]:
    links, (link, number, is_obstacle) = clearance.robot.collision_spheres, pair
    return links[link].link, clearance.obstacles[number].name if is_obstacle else links[number].link


def _link(clearance: Clearance, number: int) -> list[Shape]:
    """Shapes of a link; its spheres where it has no others."""
    robot = clearance.robot
    link = robot.collision_spheres[number]
    shapes = [s for s in robot.collision_model.geometryObjects if s.parentFrame == link.frame]
    if shapes:
        return [(int(s.parentJoint), s.placement, s.geometry) for s in shapes]
    frame = robot.model.frames[link.frame]
    spheres = zip(link.centers, link.radii, strict=True)
    placed = ((frame.placement * pin.SE3(np.eye(3), np.array(c)), coal.Sphere(float(r))) for c, r in spheres)
    return [(link.joint, at, ball) for at, ball in placed]


def _obstacle(clearance: Clearance, number: int) -> list[Shape]:
    obstacle = clearance.obstacles[number]
    frame = clearance.robot.model.frames[clearance.robot.frame_id(obstacle.frame)]
    return [(int(frame.parentJoint), frame.placement * obstacle.placement, obstacle.geometry)]
