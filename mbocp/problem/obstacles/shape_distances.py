"""Distances of links and obstacles by their own shapes, and how far their points move from pose to pose."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import chain, pairwise

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.problem.obstacles.clearance import Clearance, LinkPair
from mbocp.robot.large import make_working_data

_CONTACTS = 100  # of two meshes that are looked at

Shape = tuple[int, pin.SE3, coal.CollisionGeometry]  # a joint, where on it, and what


class ShapeDistances:
    """Distances of links and obstacles by their own shapes, at one configuration after the other.

    Parameters
    ----------
    clearance : Clearance
    pairs : list of (int, int, bool)
        A link, and an obstacle or another link.
    """

    def __init__(self, clearance: Clearance, pairs: list[LinkPair]) -> None:
        self._clearance, self._pairs = clearance, pairs
        self._model = clearance.scene
        self._data = make_working_data(self._model)
        self._geometry = pin.GeometryModel()
        first = [0]  # of the shapes of each pair
        numbers: dict[tuple[int, bool], list[int]] = {}
        for link, number, is_obstacle in pairs:
            for key in ((link, False), (number, is_obstacle)):
                if key not in numbers:
                    numbers[key] = [self._add(shape) for shape in _shapes(clearance, *key)]
            for one in numbers[link, False]:
                for other in numbers[number, is_obstacle]:
                    self._geometry.addCollisionPair(pin.CollisionPair(one, other))
            first.append(len(self._geometry.collisionPairs))
        self._numbers = [range(*ends) for ends in pairwise(first)]
        self._placed = pin.GeometryData(self._geometry)
        self._ball = cache(lambda number, is_obstacle: _ball(_shapes(clearance, number, is_obstacle)))

    def _add(self, shape: Shape) -> int:
        joint, placement, geometry = shape
        name = str(self._geometry.ngeoms)
        return int(self._geometry.addGeometryObject(pin.GeometryObject(name, joint, placement, geometry)))

    def place(self, q: Array) -> None:
        """Take a configuration of the scene, see `Clearance.scene_configurations`."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._placed, q)

    def of(self, pair: int) -> float:
        """Of the nearest shapes of a pair, negative where they are in each other [m]."""
        return min((self._distance(k) for k in self._numbers[pair]), default=np.inf)

    def are_meshes(self, pair: int) -> bool:
        """Whether all shapes of a pair are meshes, whose depth in each other is not known."""
        kinds = (self._geometry.geometryObjects[k].geometry.getObjectType() for k in self._shapes_of(pair))
        return all(kind == coal.OBJECT_TYPE.OT_BVH for kind in kinds)

    def _shapes_of(self, pair: int) -> Iterator[int]:
        pairs = (self._geometry.collisionPairs[k] for k in self._numbers[pair])
        return chain.from_iterable((pair.first, pair.second) for pair in pairs)

    def _distance(self, number: int) -> float:
        found = float(pin.computeDistance(self._geometry, self._placed, number).min_distance)
        if found != 0.0:
            return found
        # Of two meshes it is 0, however deep they are in each other: no deeper is certain than the shallowest
        # of the triangles that meet.
        pair = self._geometry.collisionPairs[number]
        shapes = (self._geometry.geometryObjects[k].geometry for k in (pair.first, pair.second))
        places = (self._placed.oMg[k] for k in (pair.first, pair.second))
        at = (coal.Transform3s(place.rotation, place.translation) for place in places)
        request, result = coal.CollisionRequest(coal.CONTACT, _CONTACTS), coal.CollisionResult()
        one, other = zip(shapes, at, strict=True)
        coal.collide(*one, *other, request, result)
        depths = (result.getContact(k).penetration_depth for k in range(result.numContacts()))
        return float(max(depths, default=0.0))

    def displacements(self, pair: int, here: Array, others: Array) -> Array:
        """By how much the shapes of a pair may have come nearer to each other in other poses, shape (n,) [m].

        Seen from the larger one, nothing on the other moves farther than the middle of a ball around it does,
        and by turning what is farthest from there.

        Parameters
        ----------
        pair : int
        here, others : ndarray, shapes (njoints, 3, 4) and (n, njoints, 3, 4)
            Placements of the joints, see `Clearance.joint_placements`.
        """
        link, number, is_obstacle = self._pairs[pair]
        one, other = self._ball(link, False), self._ball(number, is_obstacle)
        if other[2] < one[2]:
            one, other = other, one
        joint, center, radius = one
        change = _place_seen_from(others, other[0], joint) - _place_seen_from(here[None], other[0], joint)
        turn = np.sqrt((change[:, :, :3] ** 2).sum(axis=(1, 2)) / 2.0)  # of a point 1 m from its axis
        far = np.linalg.norm(change[:, :, :3] @ center + change[:, :, 3], axis=1)
        far[turn > 0.0] += radius * turn[turn > 0.0]  # a halfspace has no end
        return np.asarray(far)


def _place_seen_from(placements: Array, here: int, joint: int) -> Array:
    """Placements of a joint in the axes of another one, shape (n, 3, 4) [m]; the joint 0 is the world."""
    if not here:
        return np.asarray(placements[:, joint])
    turned, at = placements[:, here, :, :3].transpose(0, 2, 1), placements[:, joint].copy()
    at[:, :, 3] -= placements[:, here, :, 3]
    return np.asarray(turned @ at)


def _shapes(clearance: Clearance, number: int, is_obstacle: bool) -> list[Shape]:
    return _obstacle(clearance, number) if is_obstacle else _link(clearance, number)


def _ball(shapes: list[Shape]) -> tuple[int, Array, float]:
    """Joint that carries shapes, middle of a ball around them, and its radius [m]."""
    for _, _, geometry in shapes:
        geometry.computeLocalAABB()
    centers = np.array([placement.act(np.array(g.aabb_center)) for _, placement, g in shapes])
    radii = np.array([g.aabb_radius for _, _, g in shapes])
    if not np.isfinite(centers).all():
        return shapes[0][0], np.zeros(3), np.inf
    center = centers.mean(axis=0)
    return shapes[0][0], center, float((np.linalg.norm(centers - center, axis=1) + radii).max())


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
    joint = int(clearance.scene.frames[clearance.frame_of(obstacle)].parentJoint)
    return [(joint, clearance.placement_of(obstacle), obstacle.geometry)]
