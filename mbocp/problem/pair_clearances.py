"""Clearances of many pairs of spheres and shapes at many configurations, in numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot.large import working_data
from mbocp.terms.clearance import ClearanceRow
from mbocp.terms.distances import distances_from_cores

__all__ = ["PairClearances"]

_CHUNK = 200_000  # distances at a time


@dataclass(frozen=True, eq=False)
class PairClearances:
    """Distances that pairs keep, less their radii and margins.

    Attributes
    ----------
    model : pin.Model
    frames : tuple of int
        The places 1, 2, ... of the rows; the place 0 is the world.
    place, other : ndarray of int, shape (P,)
    center, at : ndarray, shape (P, 3)
    axes : ndarray, shape (P, 3, 3)
    cores : ndarray, shape (P, CORE)
    radii : ndarray, shape (P,)
        What is subtracted from distances of centres from cores [m].
    around : ndarray, shape (P,)
        Radius of a ball about the middle that has the core in it [m].
    """

    model: pin.Model
    frames: tuple[int, ...]
    place: Array
    other: Array
    center: Array
    at: Array
    axes: Array
    cores: Array
    radii: Array
    around: Array

    @classmethod
    def of(
        cls, model: pin.Model, frames: tuple[int, ...], rows: Sequence[ClearanceRow], radii: Array
    ) -> PairClearances:
        """Of rows."""
        cores = np.array([row.core.numbers for row in rows])
        return cls(
            model=model,
            frames=frames,
            place=np.array([row.place for row in rows]),
            other=np.array([row.other for row in rows]),
            center=np.array([row.center for row in rows]),
            at=np.array([row.at for row in rows]),
            axes=np.array([row.axes for row in rows]),
            cores=cores,
            radii=radii,
            around=np.linalg.norm(cores[:, :3] * (1.0 - cores[:, 3:4] * np.array([0.0, 1.0, 0.0])), axis=1),
        )

    def values(self, qs: Array) -> Array:
        """Clearances, shape (n, P) [m], by the expression that solvers see."""
        found = np.empty((len(qs), len(self.place)))
        for part, points, origins, turns in self._placed(qs):
            p = np.einsum("npji,npj->npi", turns, points - origins) - self.at
            p = np.einsum("pji,npj->npi", self.axes, p)
            found[part] = distances_from_cores(p, self.cores) - self.radii
        return found

    def least(self, qs: Array, lower: Array, most: float = np.inf) -> Array:
        """Least clearance beyond `lower` at each configuration, `most` where it is larger, shape (n,) [m]."""
        found = np.full(len(qs), most)
        for part, points, origins, turns in self._placed(qs):
            middles = np.einsum("npij,pj->npi", turns, self.at) + origins
            away = np.linalg.norm(points - middles, axis=2) - (self.around + self.radii + lower)
            n, pair = np.nonzero(away < most)
            if not len(n):
                continue
            p = np.einsum("kji,kj->ki", turns[n, pair], points[n, pair] - origins[n, pair]) - self.at[pair]
            p = np.einsum("kji,kj->ki", self.axes[pair], p)
            values = distances_from_cores(p, self.cores[pair]) - self.radii[pair] - lower[pair]
            np.minimum.at(found, part.start + n, values)
        return found

    def _placed(self, qs: Array) -> Iterator[tuple[slice, Array, Array, Array]]:
        """Some of the configurations: centres in the world; origins and axes of what carries the shapes."""
        size = max(1, _CHUNK // max(1, len(self.place)))
        for first in range(0, len(qs), size):
            part = slice(first, min(first + size, len(qs)))
            turns, origins = self._frames_at(qs[part])
            points = np.einsum("npij,pj->npi", turns[:, self.place], self.center) + origins[:, self.place]
            yield part, points, origins[:, self.other], turns[:, self.other]

    def _frames_at(self, qs: Array) -> tuple[Array, Array]:
        """Axes, shape (n, places, 3, 3), and origins, shape (n, places, 3), of all places."""
        turns = np.tile(np.eye(3), (len(qs), len(self.frames) + 1, 1, 1))
        origins = np.zeros((len(qs), len(self.frames) + 1, 3))
        data = working_data(self.model)
        joints = [int(self.model.frames[frame].parentJoint) for frame in self.frames]
        at = [self.model.frames[frame].placement for frame in self.frames]
        for k, q in enumerate(qs):
            pin.forwardKinematics(self.model, data, q)
            for place, (joint, placement) in enumerate(zip(joints, at, strict=True), start=1):
                placed = data.oMi[joint] * placement
                turns[k, place], origins[k, place] = placed.rotation, placed.translation
        return turns, origins
