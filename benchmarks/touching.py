"""Whether a motion touches anything: coal on meshes at a thousand poses a second, and nothing of mbocp's own.

Links are the shapes of the URDF, obstacles coal's primitives. Pairs that balls around both keep apart are not
looked at.
"""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicHermiteSpline

from mbocp._arrays import Array
from mbocp.problem import Problem

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
    pairs : ndarray of int, shape (n, 2)
    centers, radii : ndarray
        Of a ball around each shape, in its own axes [m].
    """

    model: pin.Model
    shapes: pin.GeometryModel
    pairs: Array
    centers: Array
    radii: Array

    @classmethod
    def of(cls, problem: Problem) -> Touching:
        """Links that move and obstacles of the world, and the pairs of links that the problem keeps apart."""
        robot, clearance = problem.robot, problem.clearance
        shapes = pin.GeometryModel(robot.collision_model)
        links = list(shapes.geometryObjects)
        pairs = []
        for obstacle in problem.obstacle:
            assert obstacle.frame == "world"
            made = pin.GeometryObject(obstacle.name, 0, obstacle.placement, obstacle.geometry)
            at = shapes.addGeometryObject(made)
            pairs += [(k, at) for k, link in enumerate(links) if link.parentJoint]
        own = clearance.self_pairs if clearance is not None else None
        for pair in own.links if own is not None else ():
            frames = [robot.frame_id(link) for link in pair]
            one, other = ([k for k, s in enumerate(links) if s.parentFrame == f] for f in frames)
            pairs += [(a, b) for a in one for b in other]
        centers, radii = [], []
        for shape in shapes.geometryObjects:
            shape.geometry.computeLocalAABB()
            centers.append(np.array(shape.geometry.aabb_center))
            radii.append(float(shape.geometry.aabb_radius))
        return cls(robot.model, shapes, np.array(pairs), np.array(centers), np.array(radii))

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
        for time in np.union1d(np.arange(t[0], t[-1], 1.0 / _RATE), t):
            n = min(int(np.searchsorted(t, time, side="right")) - 1, len(t) - 2)
            share = float((time - t[n]) / (t[n + 1] - t[n]))
            q = pin.interpolate(self.model, qs[n], qs[n + 1], share) if cubics is None else cubics(time)
            pin.updateGeometryPlacements(self.model, data, self.shapes, placed, q)
            at = np.array([p.act(c) for p, c in zip(placed.oMg, self.centers, strict=True)])
            a, b = self.pairs.T
            apart = np.linalg.norm(at[a] - at[b], axis=1) - self.radii[a] - self.radii[b]
            for one, other in self.pairs[apart <= 0.0]:
                if self._meet(placed, int(one), int(other)):
                    names = [self.shapes.geometryObjects[int(k)].name for k in (one, other)]
                    return f"{names[0]} touches {names[1]} at {time:.3f} s"
        return None

    def _meet(self, placed: pin.GeometryData, one: int, other: int) -> bool:
        shapes = [self.shapes.geometryObjects[k].geometry for k in (one, other)]
        ats = [coal.Transform3s(placed.oMg[k].rotation, placed.oMg[k].translation) for k in (one, other)]
        result = coal.CollisionResult()
        request = coal.CollisionRequest()
        coal.collide(shapes[0], ats[0], shapes[1], ats[1], request, result)
        return bool(result.isCollision())
