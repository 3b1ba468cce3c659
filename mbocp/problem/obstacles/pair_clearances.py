"""Clearances of many pairs of spheres and shapes at many configurations, in numbers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, IntArray
from mbocp._dataclass import dataclass
from mbocp.exceptions import NativeMismatch
from mbocp.robot import joints
from mbocp.robot.joints import joint_kind
from mbocp.robot.large import working_data
from mbocp.terms.clearance_term import ClearanceRow
from mbocp.terms.distances import CORE, HullCore

if TYPE_CHECKING:
    from mbocp._native._room import Room


_SCREW, _CIRCLE = 0, 1
_KINDS = {
    "revolute": _SCREW,
    "prismatic": _SCREW,
    "helical": _SCREW,
    "continuous": _CIRCLE,
    "planar": 2,
    "floating": 3,
    "spherical": 4,
    "translation": 5,
}
_LOOKED_AT = 200  # configurations at which centres of spheres are in a tree
_MOVED = 0.5  # [rad, m] of the joint whose twist is looked at: exact, for it is constant


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

    def values(self, qs: Array, near: float = np.inf) -> Array:
        """Clearances, shape (n, P) [m]; larger ones than `near` may be any number between `near` and them."""
        return np.asarray(self._room.values(_flat(qs), near)).reshape(len(qs), len(self.rows))

    def near(self, qs: Array, near: float) -> IntArray:
        """Pairs that may be nearer than `near` [m] at some of n configurations, and all that move both.

        A tree of the centres of spheres tells how far each shape is from the nearest of them.
        """
        from scipy.spatial import cKDTree  # slow to import, and wanted only where there are many pairs

        found = self._shapes
        joints, spheres = self.joint_placements(qs), self._spheres
        centers = np.concatenate(
            [joints[:, j, :, :3] @ center + joints[:, j, :, 3] for j, center in spheres]
        ).reshape(len(spheres), len(qs), 3)
        stride = -(-len(qs) // _LOOKED_AT)
        looked_at = np.minimum(np.arange(len(qs)) // stride * stride + stride // 2, len(qs) - 1)
        moved = float(np.linalg.norm(centers - centers[:, looked_at], axis=2).max())
        tree = cKDTree(centers[:, np.unique(looked_at)].reshape(-1, 3))
        away = tree.query(found.middles)[0] - moved
        return np.flatnonzero((found.moves | (found.slopes * away - found.around < near))[found.of_pairs])

    @cached_property
    def _spheres(self) -> list[tuple[int, Array]]:
        """Joint that carries a sphere, and where on it its centre is [m], of all spheres."""
        centers = {(row.place, row.center.tobytes()): row for row in self.rows}.values()
        frames = [None, *(self.model.frames[k] for k in self.frames)]
        at = [(frames[row.place], row.center) for row in centers]
        return [(f.parentJoint, f.placement.act(np.array(c))) if f else (0, c) for f, c in at]

    @cached_property
    def _shapes(self) -> _Shapes:
        numbers: dict[tuple[int, bytes, int], int] = {}
        rows, of_pairs = list[ClearanceRow](), np.zeros(len(self.rows), dtype=np.intp)
        for k, row in enumerate(self.rows):
            key = (row.other, row.at.tobytes(), id(row.core))
            if key not in numbers:
                numbers[key] = len(rows)
                rows.append(row)
            of_pairs[k] = numbers[key]
        reach = np.array([_reach(row) for row in rows]).reshape(-1, 2)
        radii = np.full(len(rows), -np.inf)
        np.maximum.at(radii, of_pairs, self.radii)
        middles, moves = np.array([row.at for row in rows]), np.array([row.other > 0 for row in rows])
        return _Shapes(middles, reach[:, 0], reach[:, 1] + radii, moves, of_pairs)

    def of_pairs(self, pairs: IntArray) -> PairClearances:
        """The same of some of the pairs."""
        return PairClearances(self.model, self.frames, tuple(self.rows[k] for k in pairs), self.radii[pairs])

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
        places = [
            [self.model.frames[k].parentJoint, *placement_numbers(self.model.frames[k].placement)]
            for k in self.frames
        ]
        of_spheres = [(row.place, *row.center.tolist()) for row in self.rows]
        cores = {id(row.core): row.core for row in self.rows if isinstance(row.core, HullCore)}
        ends = np.cumsum([0, *(len(core.planes) for core in cores.values())])
        first = dict(zip(cores, ends[:-1].tolist(), strict=True))
        of_shapes = [_shape(row, first) for row in self.rows]
        spheres, shapes = (
            {known: n for n, known in enumerate(dict.fromkeys(x))} for x in (of_spheres, of_shapes)
        )
        pairs = [
            (spheres[sphere], shapes[shape], radius)
            for sphere, shape, radius in zip(of_spheres, of_shapes, self.radii, strict=True)
        ]
        planes = np.concatenate([np.zeros(0), *(core.planes.ravel() for core in cores.values())])
        return _room_of(self.model, places, list(spheres), list(shapes), planes, pairs)


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


def joint_table(model: pin.Model) -> Array:
    """A row for each joint but the world: parent, kind, first number, placement at rest, twist of a unit.

    Returns
    -------
    ndarray, shape (njoints - 1, 21)
        The twist, linear before angular, is that of joints with one number, zero of others; joints that mimic
        another have the numbers of that one.
    """
    mimicked = dict(zip(model.mimicking_joints, model.mimicked_joints, strict=True))
    data = working_data(model)
    at_rest, moved = _placements(model, data, 0.0), _placements(model, data, _MOVED)
    rows = []
    for joint in range(1, model.njoints):
        owner = mimicked.get(joint, joint)
        kind = _KINDS[joints.joint_kind(model, owner).word]
        first = joints.configuration_slice(model, owner).start
        placement, twist = model.jointPlacements[joint], np.zeros(6)
        if kind in (_SCREW, _CIRCLE):
            placement = at_rest[joint]
            twist = _twist(placement.actInv(moved[joint]))
        rows.append([model.parents[joint], kind, first, *placement_numbers(placement), *twist])
    return np.array(rows, dtype=np.float64).reshape(-1, 21)


def placement_numbers(placement: pin.SE3) -> Array:
    """Axes by rows and origin, shape (12,)."""
    return np.concatenate([np.ravel(placement.rotation), placement.translation])


def _placements(model: pin.Model, data: pin.Data, amount: float) -> list[pin.SE3]:
    """Of each joint in its parent, where those with one number are moved by as much."""
    q = np.array(pin.neutral(model))
    for joint in range(1, model.njoints):
        kind = joints.joint_kind(model, joint)
        if kind.word in _KINDS and _KINDS[kind.word] == _SCREW:
            q[joints.configuration_slice(model, joint)] = amount
        elif kind.word == "continuous":
            q[joints.configuration_slice(model, joint)] = np.cos(amount), np.sin(amount)
    pin.forwardKinematics(model, data, q)
    return [pin.SE3(placement) for placement in data.liMi]


def _twist(moved: pin.SE3) -> Array:
    """Of a unit: linear and angular part, which are along each other or one of them is zero."""
    return np.concatenate([moved.translation, pin.log3(moved.rotation)]) / _MOVED
