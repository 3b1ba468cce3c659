"""Clearances of many pairs of spheres and shapes at many configurations, in numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

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
            p = points[:, self._sphere] - origins[:, self.other]
            if len(self._is_carried):
                p = np.einsum("npji,npj->npi", turns[:, self.other], p)
            p -= self.at
            p = np.einsum("pji,npj->npi", self.axes, p)
            found[part] = distances_from_cores(p, self.cores) - self.radii
        return found

    def least(self, qs: Array, lower: Array, most: float = np.inf) -> Array:
        """Least clearance beyond `lower` at each configuration, `most` where it is larger, shape (n,) [m]."""
        found = np.full(len(qs), most)
        reach = np.maximum(self.around + self.radii + lower + most, 0.0) ** 2
        for part, points, origins, turns in self._placed(qs):
            middles = self._middles(origins, turns)
            away = points[:, self._sphere] - middles
            n, pair = np.nonzero(np.einsum("npi,npi->np", away, away) < reach)
            if not len(n):
                continue
            place = self.other[pair]
            p = points[n, self._sphere[pair]] - origins[n, place]
            p = np.einsum("kji,kj->ki", turns[n, place], p) - self.at[pair]
            p = np.einsum("kji,kj->ki", self.axes[pair], p)
            values = distances_from_cores(p, self.cores[pair]) - self.radii[pair] - lower[pair]
            np.minimum.at(found, part.start + n, values)
        return found

    @cached_property
    def _spheres(self) -> tuple[Array, NDArray[np.int64]]:
        """Place and centre of each sphere, shape (S, 4); which of them each pair has."""
        table = np.column_stack([self.place, self.center])
        found, which = np.unique(table, axis=0, return_inverse=True)
        return found, np.asarray(which.ravel(), dtype=np.int64)

    @property
    def _sphere(self) -> NDArray[np.int64]:
        return self._spheres[1]

    @cached_property
    def _is_carried(self) -> NDArray[np.int64]:
        return np.asarray(np.flatnonzero(self.other), dtype=np.int64)

    def _middles(self, origins: Array, turns: Array) -> Array:
        """Middles of the cores in the world, shape (n, P, 3) [m]."""
        middles = np.tile(self.at, (len(origins), 1, 1))
        carried = self._is_carried
        if len(carried):
            place = self.other[carried]
            middles[:, carried] = origins[:, place] + np.einsum(
                "npij,pj->npi", turns[:, place], self.at[carried]
            )
        return middles

    def _placed(self, qs: Array) -> Iterator[tuple[slice, Array, Array, Array]]:
        """Some of the configurations: centres of the spheres in the world; origins and axes of all places."""
        size = max(1, _CHUNK // max(1, len(self.place)))
        table = self._spheres[0]
        place, center = table[:, 0].astype(np.int64), table[:, 1:]
        for first in range(0, len(qs), size):
            part = slice(first, min(first + size, len(qs)))
            turns, origins = self._frames_at(qs[part])
            points = np.einsum("nsij,sj->nsi", turns[:, place], center) + origins[:, place]
            yield part, points, origins, turns

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
