"""Clearances of many pairs of spheres and shapes at many configurations, in numbers."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, IntArray
from mbocp._dataclass import dataclass
from mbocp.exceptions import NativeMismatch
from mbocp.problem.obstacles.joint_table import joint_table, placement_numbers
from mbocp.robot.joints import joint_kind
from mbocp.terms.clearance_term import ClearanceRow
from mbocp.terms.distances import CORE, HullCore

if TYPE_CHECKING:
    from mbocp._native._room import Room


_LOOKED_AT = 200  # configurations at which centres of spheres are in a tree


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


@dataclass(frozen=True, eq=False)
class _Shapes:
    """Shapes of pairs: one at a distance r of its middle is slope r - around away at least, less all radii.

    Attributes
    ----------
    middles : ndarray, shape (n, 3)
        In the world, of those that stand there [m].
    slopes, around : ndarray, shape (n,)
        Around includes the largest radius [m].
    moves : ndarray of bool, shape (n,)
        Whether it moves.
    of_pairs : ndarray of int, shape (P,)
        Shape of each pair.
    """

    middles: Array
    slopes: Array
    around: Array
    moves: BoolArray
    of_pairs: IntArray


@dataclass(frozen=True, eq=False)
class PairClearances:
    """Distances that pairs keep, less their radii, by the expression that solvers see.

    Attributes
    ----------
    model : pin.Model
    frames : tuple of int
        The places 1, 2, ... of the rows; the place 0 is the world.
    rows : tuple of ClearanceRow
        A pair each.
    radii : ndarray, shape (P,)
        What is subtracted from distances of centres from cores [m].
    """

    model: pin.Model
    frames: tuple[int, ...]
    rows: tuple[ClearanceRow, ...]
    radii: Array

    @classmethod
    def of(
        cls, model: pin.Model, frames: tuple[int, ...], rows: Sequence[ClearanceRow], radii: Array
    ) -> PairClearances:
        """Of rows."""
        return cls(model, frames, tuple(rows), radii)

    def values(self, qs: Array, near: float = np.inf, pairs: IntArray | None = None) -> Array:
        """Clearances of pairs, by default of all, shape (n, pairs) [m].

        Larger ones than `near` may be any number between `near` and them.
        """
        room = self._room if pairs is None else self._room_of_pairs(pairs)
        width = len(self.rows if pairs is None else pairs)
        return np.asarray(room.values(_flat(qs), near)).reshape(len(qs), width)

    def near(self, qs: Array, near: float) -> IntArray:
        """Pairs that may be nearer than `near` [m] at some of n configurations, and all that move both.

        A tree of the spheres' centres tells how far each shape is from the nearest of them.
        """
        from scipy.spatial import cKDTree  # slow to import, and wanted only where there are many pairs

        found, count = self._shapes, len(qs)
        joints = self.joint_placements(qs)
        centers = np.concatenate(
            [(joints[:, j].reshape(-1, 4) @ at).reshape(count, 3, -1) for j, at in self._spheres.items()],
            axis=2,
        )
        stride = -(-count // _LOOKED_AT)
        looked_at = np.minimum(np.arange(count) // stride * stride + stride // 2, count - 1)
        ways = centers - centers[looked_at]
        moved = float(np.einsum("nkj,nkj->nj", ways, ways).max()) ** 0.5
        points = centers[np.unique(looked_at)].transpose(0, 2, 1).reshape(-1, 3)
        tree = cKDTree(points, balanced_tree=False, compact_nodes=False)  # it is asked a few times alone
        away = tree.query(found.middles)[0] - moved
        return np.flatnonzero((found.moves | (found.slopes * away - found.around < near))[found.of_pairs])

    @cached_property
    def _of_spheres(self) -> tuple[list[ClearanceRow], IntArray]:
        """A row for each sphere, and the sphere of each pair."""
        return _distinct(self.rows, lambda row: (row.place, row.center.tobytes()))

    @cached_property
    def _of_shapes(self) -> tuple[list[ClearanceRow], IntArray]:
        """A row for each shape, and the shape of each pair."""
        return _distinct(
            self.rows, lambda row: (row.other, row.at.tobytes(), row.axes.tobytes(), id(row.core))
        )

    @cached_property
    def _spheres(self) -> dict[int, Array]:
        """Centres of the spheres on each joint that has some, shape (4, any) with ones in the end [m]."""
        frames = [None, *(self.model.frames[k] for k in self.frames)]
        found: dict[int, list[Array]] = {}
        for row in self._of_spheres[0]:
            frame = frames[row.place]
            center = np.array(row.center) if frame is None else frame.placement.act(np.array(row.center))
            found.setdefault(0 if frame is None else frame.parentJoint, []).append(np.append(center, 1.0))
        return {joint: np.column_stack(centers) for joint, centers in found.items()}

    @cached_property
    def _shapes(self) -> _Shapes:
        rows, of_pairs = self._of_shapes
        reach = np.array([_reach(row) for row in rows]).reshape(-1, 2)
        radii = np.full(len(rows), -np.inf)
        np.maximum.at(radii, of_pairs, self.radii)
        middles, moves = np.array([row.at for row in rows]), np.array([row.other > 0 for row in rows])
        return _Shapes(middles, reach[:, 0], reach[:, 1] + radii, moves, of_pairs)

    def joint_placements(self, qs: Array) -> Array:
        """Rotation and origin of each joint at each configuration, shape (n, njoints, 3, 4) [m]."""
        found = _room_of(self.model).joints(_flat(qs))
        return np.asarray(found).reshape(len(qs), self.model.njoints, 3, 4)

    def least(self, qs: Array, lower: Array, most: float = np.inf) -> Array:
        """Least clearance beyond `lower` at each configuration, `most` where it is larger, shape (n,) [m]."""
        return np.asarray(self._room.least(_flat(qs), _flat(lower), most))

    def way(
        self, ends: Array, lower: Array, ranges: Array, reserve: float, seed: int, size: WaySize
    ) -> Array | None:
        """Corners of a way that keeps a reserve beyond `lower`, shape (n, nq); None if none is found.

        Two trees of configurations grow from both ends towards random places and each other until they meet
        (RRT-Connect); then corners are cut. The same seed has the same way.

        Parameters
        ----------
        ends : ndarray, shape (2, nq)
        lower : ndarray, shape (P,)
            Least clearances [m].
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
            lower=_flat(lower),
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
        return self._room_of_pairs(np.arange(len(self.rows)))

    def _room_of_pairs(self, pairs: IntArray) -> Room:
        """Some of the pairs, with the spheres and shapes that these have."""
        places, spheres, shapes, planes = self._tables
        kept_spheres, sphere = np.unique(self._of_spheres[1][pairs], return_inverse=True)
        kept_shapes, shape = np.unique(self._of_shapes[1][pairs], return_inverse=True)
        table = np.column_stack([sphere, shape, self.radii[pairs]])
        return _room_of(self.model, places, spheres[kept_spheres], shapes[kept_shapes], planes, table)

    @cached_property
    def _tables(self) -> tuple[Array, Array, Array, Array]:
        """Of places, spheres and shapes, a row each, and of planes."""
        places = [
            [self.model.frames[k].parentJoint, *placement_numbers(self.model.frames[k].placement)]
            for k in self.frames
        ]
        rows = self._of_shapes[0]
        cores = {id(row.core): row.core for row in rows if isinstance(row.core, HullCore)}
        ends = np.cumsum([0, *(len(core.planes) for core in cores.values())])
        first = dict(zip(cores, ends[:-1].tolist(), strict=True))
        spheres = np.array([(row.place, *row.center) for row in self._of_spheres[0]]).reshape(-1, 4)
        shapes = np.array([_shape(row, first) for row in rows]).reshape(-1, 13 + CORE + 5)
        planes = np.concatenate([np.zeros(0), *(core.planes.ravel() for core in cores.values())])
        return np.array(places, dtype=np.float64), spheres, shapes, planes


def _distinct(
    rows: Sequence[ClearanceRow], key: Callable[[ClearanceRow], Hashable]
) -> tuple[list[ClearanceRow], IntArray]:
    """The first row of each key, and which of these each row is like."""
    numbers: dict[Hashable, int] = {}
    found = np.array([numbers.setdefault(key(row), len(numbers)) for row in rows], dtype=np.intp)
    return [rows[k] for k in np.unique(found, return_index=True)[1]], found


def _room_of(model: pin.Model, *tables: Array | Sequence[object]) -> Room:
    """A room of places, spheres, shapes, planes and pairs; of joints alone without them."""
    try:
        from mbocp._native import _room
    except ImportError as error:
        raise NativeMismatch(
            f"the native part cannot be loaded ({error}); build it with `make` or `pip install .`"
        ) from error
    names = ("places", "spheres", "shapes", "planes", "pairs")
    given = dict(zip(names, map(_flat, tables or [[]] * len(names)), strict=True))
    return _room.Room(nq=model.nq, joints=_flat(joint_table(model)), **given)


def _shape(row: ClearanceRow, first: dict[int, int]) -> tuple[float, ...]:
    """Place, middle, axes, core, planes, and how near a point is at least.

    Planes of a hull are the first and how many, with their sharpness. A point at a distance r from the middle
    is at least slope r - around from the shape; of a core around is the radius of a ball that has it in it.

    Parameters
    ----------
    row : ClearanceRow
    first : mapping of int to int
        First plane of each hull, by the identity of its core.
    """
    placed = (row.other, *row.at.tolist(), *row.axes.ravel().tolist())
    if isinstance(row.core, HullCore):
        count = len(row.core.planes)
        return (*placed, *[0.0] * CORE, first[id(row.core)], count, row.core.sharpness, *_reach(row))
    return (*placed, *row.core.numbers.tolist(), 0, 0, 0.0, *_reach(row))


def _reach(row: ClearanceRow) -> tuple[float, float]:
    """Slope and around."""
    if isinstance(row.core, HullCore):
        return row.core.slope, float(row.core.planes[:, 3].max())
    core = row.core.numbers
    sides = core[:3] * np.array([1.0, 1.0 - core[3], 1.0])  # across a cylinder its radius counts alone
    return 1.0, float(np.linalg.norm(sides))


def _flat(table: Array | Sequence[object]) -> Array:
    return np.ascontiguousarray(table, dtype=np.float64).ravel()
