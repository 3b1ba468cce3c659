"""Whether a motion touches anything: coal on meshes at a thousand poses a second, and nothing of mbocp's own.

Links are the shapes of the URDF, obstacles coal's primitives, or surfaces that are given. Of links all pairs
are looked at but those of one joint, of neighbours, what a file disables, and what meets at the start. Pairs
that balls around both keep apart are not looked at.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations

import coal
import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicHermiteSpline

from mbocp._arrays import Array
from mbocp.problem import Problem
from mbocp.robot.collision.obstacle import Obstacle

__all__ = ["Touching"]

_RATE = 1000.0  # poses a second


@dataclass(frozen=True, eq=False)
class Touching:
    """Pairs of shapes that must not meet.

    Attributes
    ----------
    model : pin.Model
    shapes : pin.GeometryModel
        Those of the links, then the obstacles on joint 0.
    pairs, own : ndarray of int, shape (n, 2)
        Links and obstacles, and links alone.
    centers, radii : ndarray
        Of a ball around each shape, in its own axes [m].
    """

    model: pin.Model
    shapes: pin.GeometryModel
    pairs: Array
    own: Array
    centers: Array
    radii: Array

    @classmethod
    def of(cls, problem: Problem, surfaces: Sequence[pin.GeometryObject] | None = None) -> Touching:
        """Links that move and obstacles, or surfaces in their place; links and links where these are kept."""
        robot, clearance = problem.robot, problem.clearance
        shapes = pin.GeometryModel(robot.collision_model)
        links = [pin.GeometryObject(link) for link in shapes.geometryObjects]  # adding moves the others
        pairs = []
        for made in map(_placed, problem.obstacle) if surfaces is None else surfaces:
            at = shapes.addGeometryObject(made)
            pairs += [(k, at) for k, link in enumerate(links) if link.parentJoint]
        kept = None if clearance is None else clearance.self_pairs
        disabled = () if kept is None else map(frozenset, kept.left_out.get("disabled", ()))
        own = [] if kept is None else _pairs_of_links(robot.model, links, set(disabled))
        centers, radii = [], []
        for shape in shapes.geometryObjects:
            shape.geometry.computeLocalAABB()
            centers.append(np.array(shape.geometry.aabb_center))
            radii.append(float(shape.geometry.aabb_radius))
        indices = (np.array(found, dtype=int).reshape(-1, 2) for found in (pairs, own))
        return cls(robot.model, shapes, *indices, np.array(centers), np.array(radii))

    def first(self, t: Array, qs: Array, vs: Array | None = None) -> str | None:
        """What touches first, and when; None if nothing does.

        Parameters
        ----------
        t : ndarray, shape (N + 1,)
            Times of the nodes [s].
        qs : ndarray, shape (N + 1, nq)
            Between them the motion goes along geodesics,
        vs : ndarray, shape (N + 1, nv), optional
            or, of joints that are plain, along the cubics of these velocities.
        """
        cubics = None if vs is None else CubicHermiteSpline(t, qs, vs)
        data, placed = self.model.createData(), pin.GeometryData(self.shapes)
        pin.updateGeometryPlacements(self.model, data, self.shapes, placed, np.array(qs[0]))
        apart = [not self._meet(placed, int(one), int(other)) for one, other in self.own]
        pairs = np.vstack([self.pairs, self.own[apart]])
        for time in np.union1d(np.arange(t[0], t[-1], 1.0 / _RATE), t):
            n = min(int(np.searchsorted(t, time, side="right")) - 1, len(t) - 2)
            share = float((time - t[n]) / (t[n + 1] - t[n]))
            q = pin.interpolate(self.model, qs[n], qs[n + 1], share) if cubics is None else cubics(time)
            pin.updateGeometryPlacements(self.model, data, self.shapes, placed, q)
            for one, other in pairs[self._may_meet(placed, pairs)]:
                if self._meet(placed, int(one), int(other)):
                    names = [self.shapes.geometryObjects[int(k)].name for k in (one, other)]
                    return f"{names[0]} touches {names[1]} at {time:.3f} s"
        return None

    def _may_meet(self, placed: pin.GeometryData, pairs: Array) -> Array:
        """Whether the balls around both shapes of each pair meet."""
        at = np.array([p.act(c) for p, c in zip(placed.oMg, self.centers, strict=True)])
        a, b = pairs.T
        return np.asarray(np.linalg.norm(at[a] - at[b], axis=1) <= self.radii[a] + self.radii[b])

    def _meet(self, placed: pin.GeometryData, one: int, other: int) -> bool:
        shapes = [self.shapes.geometryObjects[k].geometry for k in (one, other)]
        ats = [coal.Transform3s(placed.oMg[k].rotation, placed.oMg[k].translation) for k in (one, other)]
        result = coal.CollisionResult()
        request = coal.CollisionRequest()
        coal.collide(shapes[0], ats[0], shapes[1], ats[1], request, result)
        return bool(result.isCollision())


def _placed(obstacle: Obstacle) -> pin.GeometryObject:
    assert obstacle.frame == "world"
    return pin.GeometryObject(obstacle.name, 0, obstacle.placement, obstacle.geometry)


def _pairs_of_links(
    model: pin.Model, links: Sequence[pin.GeometryObject], disabled: Collection[frozenset[str]]
) -> list[tuple[int, int]]:
    """All but those that one joint moves, that are neighbours, or that are disabled."""
    joints = [link.parentJoint for link in links]
    names = [model.frames[link.parentFrame].name for link in links]
    parents = [(joint, model.parents[joint]) for joint in joints]
    return [
        (a, b)
        for a, b in combinations(range(len(links)), 2)
        if joints[a] not in parents[b]
        and joints[b] not in parents[a]
        and frozenset((names[a], names[b])) not in disabled
    ]
