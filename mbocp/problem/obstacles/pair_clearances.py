"""Clearances of many pairs of spheres and shapes at many configurations, in numbers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, IntArray, dataclass
from mbocp.problem.obstacles.joint_table import joint_table, placement_numbers
from mbocp.programme.native_modules import explain_native_loading
from mbocp.robot.joints import joint_kind
from mbocp.terms.clearance_term import ClearanceRow
from mbocp.terms.distances import CORE, Core, HullCore

if TYPE_CHECKING:
    from mbocp._native._room import Room


@dataclass(frozen=True)
class WaySize:
    """How long a way is looked for.

    Attributes
    ----------
    step, resolution : float
        Of a tree, and between two configurations that are looked at, in the configuration space.
    most : int
        Steps of both trees.
    cuts : int
        Tries to cut a corner.
    """

    step: float
    resolution: float
    most: int
    cuts: int


class PlacedShape(NamedTuple):
    """A shape: what carries it, the middle of its core and its axes, columns, there [m], and its core."""

    place: int
    at: Array
    axes: Array
    core: Core | HullCore


@dataclass(frozen=True, eq=False)
class PairClearances:
    """Distances that pairs keep, less their radii, by the expression that solvers see.

    Attributes
    ----------
    model : pin.Model
    frames : tuple of int
        The places 1, 2, ... of spheres and shapes; the place 0 is the world.
    spheres : tuple of (int, ndarray)
        Place, and centre there, shape (3,) [m].
    shapes : tuple of PlacedShape
    pairs : ndarray, shape (P, 5)
        Sphere; shape; what is subtracted from the distance of centre and core [m]; margin [m]; and the group,
        which pairs of the same two things have in common.
    """

    model: pin.Model
    frames: tuple[int, ...]
    spheres: tuple[tuple[int, Array], ...]
    shapes: tuple[PlacedShape, ...]
    pairs: Array

    def of_pairs(self, pairs: IntArray, model: pin.Model, frames: tuple[int, ...]) -> PairClearances:
        """Some of the pairs, and what they need, in a model whose first frames are all that carry them."""
        table = self.pairs[pairs]
        kept_spheres, table[:, 0] = np.unique(table[:, 0].astype(np.intp), return_inverse=True)
        kept_shapes, table[:, 1] = np.unique(table[:, 1].astype(np.intp), return_inverse=True)
        spheres, shapes = (self.spheres[k] for k in kept_spheres), (self.shapes[k] for k in kept_shapes)
        return PairClearances(model, frames, tuple(spheres), tuple(shapes), table)

    def row(self, pair: int, kept: float = 0.0) -> ClearanceRow:
        """What solvers see of a pair whose distance of centre and core is to be so large at least [m]."""
        sphere, shape = self.pairs[pair, :2].astype(np.intp)
        (place, center), (other, at, axes, core) = self.spheres[sphere], self.shapes[shape]
        return ClearanceRow(place, other, center, at, axes, core, kept)

    def values(self, qs: Array, near: float = np.inf, pairs: IntArray | None = None) -> Array:
        """Clearances of pairs, by default of all, shape (n, pairs) [m].

        Larger ones than `near` may be any number between `near` and them.
        """
        chosen = np.arange(len(self.pairs)) if pairs is None else pairs
        return np.asarray(self._room.values(_flat(qs), near, _flat(chosen))).reshape(len(qs), len(chosen))

    def of_groups(self, qs: Array, near: float) -> Array:
        """Least clearances beyond margins of each group, with sharp edges, shape (n, groups) [m].

        Larger ones than `near` may be any number between `near` and them.
        """
        count = int(self.pairs[:, 4].max(initial=-1.0)) + 1
        return np.asarray(self._room.groups(_flat(qs), near)).reshape(len(qs), count)

    def nearest(self, qs: Array, near: float) -> Array:
        """Least clearance of each pair beyond its margin at all of these, at most `near`, shape (P,) [m]."""
        return np.asarray(self._room.nearest(_flat(qs), near))

    def joint_placements(self, qs: Array) -> Array:
        """Rotation and origin of each joint at each configuration, shape (n, njoints, 3, 4) [m]."""
        return np.asarray(self._room.joints(_flat(qs))).reshape(len(qs), self.model.njoints, 3, 4)

    def least(self, qs: Array, most: float = np.inf) -> Array:
        """Least clearance beyond margins at each configuration, `most` where it is larger, shape (n,) [m]."""
        return np.asarray(self._room.least(_flat(qs), most))

    def way(self, ends: Array, ranges: Array, reserve: float, seed: int, size: WaySize) -> Array | None:
        """Corners of a way that keeps a reserve beyond margins, shape (n, nq); None if none is found.

        Two trees of configurations grow from both ends towards random places and each other until they meet
        (RRT-Connect); then corners are cut. The same seed has the same way.

        Parameters
        ----------
        ends : ndarray, shape (2, nq)
        ranges : ndarray, shape (3, nq)
            Lower and upper limits of configurations, and how far from the line between the ends random places
            are.
        reserve : float
            [m].
        seed : int
        size : WaySize

        References
        ----------
        Kuffner, LaValle, "RRT-Connect: an efficient approach to single-query path planning", 2000.
        """
        found = self._room.way(
            ends=_flat(ends),
            ranges=_flat(ranges),
            groups=self._groups,
            reserve=reserve,
            step=size.step,
            resolution=size.resolution,
            most=size.most,
            cuts=size.cuts,
            seed=seed,
        )
        return np.asarray(found).reshape(-1, self.model.nq) if len(found) else None

    @property
    def _groups(self) -> Array:
        """First number and count of all numbers of unit length."""
        found = []
        for joint in range(1, self.model.njoints):
            first = self.model.joints[joint].idx_q
            found += [(first + a, b - a) for a, b in joint_kind(self.model, joint).unit_groups]
        return np.array(found, dtype=np.float64).ravel()

    @cached_property
    def _room(self) -> Room:
        with explain_native_loading():
            from mbocp._native import _room
        frames = [self.model.frames[k] for k in self.frames]
        cores = {id(shape.core): shape.core for shape in self.shapes if isinstance(shape.core, HullCore)}
        ends = np.cumsum([0, *(len(core.planes) for core in cores.values())])
        first = dict(zip(cores, ends[:-1].tolist(), strict=True))
        return _room.Room(
            nq=self.model.nq,
            joints=_flat(joint_table(self.model)),
            places=_flat([[frame.parentJoint, *placement_numbers(frame.placement)] for frame in frames]),
            spheres=_flat([(place, *center) for place, center in self.spheres]),
            shapes=_flat([_shape(shape, first) for shape in self.shapes]),
            planes=np.concatenate([np.zeros(0), *(core.planes.ravel() for core in cores.values())]),
            pairs=_flat(self.pairs),
        )


def _shape(shape: PlacedShape, first: dict[int, int]) -> tuple[float, ...]:
    """Place, middle, axes, core, planes, and how near a point is at least.

    Planes of a hull are the first and how many, with their sharpness. A point at a distance r from the middle
    is at least slope r - around from the shape; of a core around is the radius of a ball that has it in it.

    Parameters
    ----------
    shape : PlacedShape
    first : mapping of int to int
        First plane of each hull, by the identity of its core.
    """
    placed = (shape.place, *shape.at.tolist(), *shape.axes.ravel().tolist())
    if isinstance(shape.core, HullCore):
        count = len(shape.core.planes)
        return (*placed, *[0.0] * CORE, first[id(shape.core)], count, shape.core.sharpness, *_reach(shape))
    return (*placed, *shape.core.numbers.tolist(), 0, 0, 0.0, *_reach(shape))


def _reach(shape: PlacedShape) -> tuple[float, float]:
    """Slope and around."""
    if isinstance(shape.core, HullCore):
        return shape.core.slope, float(shape.core.planes[:, 3].max())
    core = shape.core.numbers
    sides = core[:3] * np.array([1.0, 1.0 - core[3], 1.0])  # across a cylinder its radius counts alone
    return 1.0, float(np.linalg.norm(sides))


def _flat(table: Array | IntArray | Sequence[object]) -> Array:
    return np.ascontiguousarray(table, dtype=np.float64).ravel()
