"""The nearest approach of a motion to obstacles, and of links to each other, between nodes, too.

The motion is sampled at a thousand poses a second, on geodesics from node to node. Spheres say at once how
near a link can be at most; where that may be nearer than what has been found, coal computes the distance of
the link's own shapes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.problem.clearance import Clearance
from mbocp.robot.large import working_data

__all__ = ["Approach", "nearest_approach", "poses_between"]

_RATE = 1000.0  # poses a second
_MOST = 50_000  # poses


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


@dataclass(frozen=True, eq=False)
class _Thing:
    """Shapes on joints."""

    name: str
    shapes: tuple[tuple[int, pin.SE3, coal.CollisionGeometry], ...]

    def placed(self, data: pin.Data) -> Iterator[tuple[coal.Transform3s, coal.CollisionGeometry]]:
        for joint, placement, geometry in self.shapes:
            at = data.oMi[joint] * placement
            yield coal.Transform3s(at.rotation, at.translation), geometry


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
    robot = clearance.robot
    times, sampled = poses_between(robot.model, t, qs)
    pairs, bounds, margins = _bounds(clearance, sampled)
    links = [_link(clearance, number) for number in range(len(robot.collision_spheres))]
    obstacles = [_obstacle(clearance, number) for number in range(len(clearance.obstacles))]
    data, at = working_data(robot.model), -1
    best: Approach | None = None
    for flat in np.argsort(bounds, axis=None, kind="stable"):
        n, k = divmod(int(flat), len(pairs))
        if best is not None and bounds[n, k] >= best.distance - best.margin:
            break
        if n != at:
            pin.forwardKinematics(robot.model, data, sampled[n])
            at = n
        a, b, is_obstacle = pairs[k]
        one, other = links[a], obstacles[b] if is_obstacle else links[b]
        distance = _distance(one, other, data)
        if best is None or distance - margins[k] < best.distance - best.margin:
            best = Approach(distance, margins[k], one.name, other.name, float(times[n]), is_obstacle)
    return best


def poses_between(model: pin.Model, t: Array, qs: Array) -> tuple[Array, Array]:
    """Times and configurations between the nodes, a thousand a second, and the nodes."""
    t = np.asarray(t, dtype=np.float64)
    times = np.linspace(t[0], t[-1], min(int(np.ceil((t[-1] - t[0]) * _RATE)) + 1, _MOST))
    times = np.union1d(times, t)
    step = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 2)
    shares = (times - t[step]) / (t[step + 1] - t[step])
    if model.nq == model.nv:  # coordinates of a vector space
        return times, qs[step] + shares[:, None] * (qs[step + 1] - qs[step])
    found = [pin.interpolate(model, qs[k], qs[k + 1], s) for k, s in zip(step, shares, strict=True)]
    return times, np.array(found)


def _bounds(clearance: Clearance, qs: Array) -> tuple[list[tuple[int, int, bool]], Array, list[float]]:
    """Pairs of a link and an obstacle or link; bounds of their distances beyond margins; their margins."""
    links = clearance.robot.collision_spheres
    gaps = [0.0 if np.isnan(link.gap) else link.gap for link in links]
    values = clearance.pair_values(qs) - clearance.margins
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


def _link(clearance: Clearance, number: int) -> _Thing:
    """Shapes of a link; its spheres where it has no others."""
    robot = clearance.robot
    link = robot.collision_spheres[number]
    shapes = [s for s in robot.collision_model.geometryObjects if s.parentFrame == link.frame]
    if shapes:
        return _Thing(link.link, tuple((int(s.parentJoint), s.placement, s.geometry) for s in shapes))
    frame = robot.model.frames[link.frame]
    spheres = zip(link.centers, link.radii, strict=True)
    placed = ((frame.placement * pin.SE3(np.eye(3), np.array(c)), coal.Sphere(float(r))) for c, r in spheres)
    return _Thing(link.link, tuple((link.joint, at, ball) for at, ball in placed))


def _obstacle(clearance: Clearance, number: int) -> _Thing:
    obstacle = clearance.obstacles[number]
    frame = clearance.robot.model.frames[clearance.robot.frame_id(obstacle.frame)]
    placed = frame.placement * obstacle.placement
    return _Thing(obstacle.name, ((int(frame.parentJoint), placed, obstacle.geometry),))


def _distance(one: _Thing, other: _Thing, data: pin.Data) -> float:
    found = np.inf
    others = list(other.placed(data))
    for at, shape in one.placed(data):
        for there, obstacle in others:
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            found = min(found, float(coal.distance(shape, at, obstacle, there, request, result)))
    return found
