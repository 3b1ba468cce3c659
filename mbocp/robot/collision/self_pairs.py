"""Pairs of links that may collide with each other."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import partial
from itertools import combinations
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot import joints
from mbocp.robot.collision.spheres import LinkSpheres

_POSES = 400
_RESERVE = 0.05  # [m]: links that stay farther apart than this in all poses are left out


class SelfPairs(NamedTuple):
    """Which spheres of which links keep away from each other, and which pairs of links are left out.

    Attributes
    ----------
    spheres : tuple of ((int, int), (int, int))
        Index of a link among the spheres' links, and of a sphere of it, twice.
    links : tuple of (str, str)
        Pairs of links with such spheres.
    left_out : mapping of str to tuple of (str, str)
        Pairs of links by the reason for which they are left out.
    overlaps : tuple of float
        How deep spheres of a pair are in each other in poses in which the shapes of both links are not, where
        that is so in the default pose [m].
    """

    spheres: tuple[tuple[tuple[int, int], tuple[int, int]], ...]
    links: tuple[tuple[str, str], ...]
    left_out: dict[str, tuple[tuple[str, str], ...]]
    overlaps: tuple[float, ...]


def self_pairs(
    model: pin.Model,
    links: Sequence[LinkSpheres],
    q0: Array,
    limits: tuple[Array, Array],
    shapes: pin.GeometryModel,
    disabled: Collection[frozenset[str]] = (),
) -> SelfPairs:
    """Pairs of links that can meet, and do not do so by their build.

    Parameters
    ----------
    model : pin.Model
    links : sequence of LinkSpheres
    q0 : ndarray, shape (nq,)
        Default pose: links that meet in it are left out.
    limits : tuple of ndarray, shapes (nq,)
        Range of the poses that are tried.
    shapes : pin.GeometryModel
        Of the links. One without shapes is its spheres.
    disabled : collection of frozenset of str
        Pairs of links by name that are left out.
    """
    poses = [q0, *_poses(model, q0, *limits)]
    placed, meeting = _place(model, links, poses), _Meeting(model, shapes, poses)
    chosen, kept, overlaps = [], [], list[float]()
    left_out: dict[str, list[tuple[str, str]]] = {}
    for a, b in combinations(range(len(links)), 2):
        names = links[a].link, links[b].link
        gaps = None
        reason = _by_build(model, links[a], links[b], disabled)
        if not reason:
            reach = links[a].radii[:, None] + links[b].radii
            # Poses, spheres of a, spheres of b.
            gaps = np.linalg.norm(placed[a][:, :, None] - placed[b][:, None], axis=3) - reach
            overlap = _overlap(gaps, partial(meeting.is_at, links[a].frame, links[b].frame))
            gaps += overlap
            reason = _by_distance(gaps.min(axis=(1, 2)))
        if reason or gaps is None:
            left_out.setdefault(reason, []).append(names)
            continue
        near = np.argwhere(gaps.min(axis=0) <= _RESERVE)
        chosen += [((a, int(i)), (b, int(j))) for i, j in near]
        overlaps += overlap[tuple(near.T)].tolist()
        kept.append(names)
    told = {reason: tuple(pairs) for reason, pairs in left_out.items()}
    return SelfPairs(tuple(chosen), tuple(kept), told, tuple(overlaps))


def _by_build(model: pin.Model, a: LinkSpheres, b: LinkSpheres, disabled: Collection[frozenset[str]]) -> str:
    """Why two links are left out whatever their distance; empty if they are not."""
    if a.joint == b.joint:
        return "moved by one joint"
    if b.joint == model.parents[a.joint] or a.joint == model.parents[b.joint]:
        return "next to each other"
    return "disabled" if frozenset((a.link, b.link)) in disabled else ""


def _overlap(gaps: Array, meet: Callable[[int], bool]) -> Array:
    """How deep pairs of spheres are in each other where shapes do not meet, nor in the default pose [m].

    So no pose of these is kept out. Some are let in in which shapes meet: distances of shapes tell there.

    Parameters
    ----------
    gaps : ndarray, shape (poses, spheres, spheres)
        [m].
    meet : callable
        Whether the shapes meet in a pose, by its number.
    """
    if gaps[0].min() >= 0.0 or meet(0):
        return np.zeros(gaps.shape[1:])
    deep = np.flatnonzero(gaps.min(axis=(1, 2)) < 0.0)
    apart = [n for n in deep if not meet(int(n))]
    return np.asarray(np.maximum(-gaps[apart].min(axis=0), 0.0))


class _Meeting:
    """Which shapes meet in poses."""

    def __init__(self, model: pin.Model, shapes: pin.GeometryModel, poses: Sequence[Array]) -> None:
        self._model, self._shapes, self._poses = model, shapes, poses
        self._data, self._placed = model.createData(), pin.GeometryData(shapes)

    def is_at(self, one: int, other: int, pose: int) -> bool:
        """Whether shapes on two frames meet in a pose, or one has none."""
        a, b = (self._of(frame) for frame in (one, other))
        q = np.array(self._poses[pose])
        pin.updateGeometryPlacements(self._model, self._data, self._shapes, self._placed, q)
        return not (a and b) or any(self._collide(i, j) for i in a for j in b)

    def _of(self, frame: int) -> list[int]:
        return [k for k, shape in enumerate(self._shapes.geometryObjects) if shape.parentFrame == frame]

    def _collide(self, *pair: int) -> bool:
        found: list[object] = []
        for k in pair:
            at = self._placed.oMg[k]
            found += [self._shapes.geometryObjects[k].geometry, coal.Transform3s(at.rotation, at.translation)]
        return bool(coal.collide(*found, coal.CollisionRequest(), coal.CollisionResult()))


def _by_distance(nearest: Array) -> str:
    """Why two links are left out by their distances [m] in the default pose and others; empty if not."""
    if nearest[0] < 0.0:
        return "touching in the default pose"
    if (nearest[1:] < 0.0).all():
        return "always touching"
    return "never near each other" if nearest.min() > _RESERVE else ""


def _place(model: pin.Model, links: Sequence[LinkSpheres], qs: Sequence[Array]) -> list[Array]:
    """Centres of each link's spheres in the world, shape (poses, spheres, 3)."""
    data = model.createData()
    found = [np.empty((len(qs), len(link.centers), 3)) for link in links]
    for n, q in enumerate(qs):
        pin.framesForwardKinematics(model, data, np.array(q))
        for link, places in zip(links, found, strict=True):
            at = data.oMf[link.frame]
            places[n] = link.centers @ at.rotation.T + at.translation
    return found


def _poses(model: pin.Model, q0: Array, q_lower: Array, q_upper: Array) -> list[Array]:
    """Poses within limits, the same every time; what turns without limits turns all the way."""
    rng = np.random.default_rng(0)
    found = []
    for _ in range(_POSES):
        turn = rng.uniform(-np.pi, np.pi, model.nv)
        for joint in range(1, model.njoints):
            if model.parents[joint] == 0 and joints.joint_kind(model, joint).word == "floating":
                turn[joints.velocity_slice(model, joint)] = 0.0  # where the whole robot is does not matter
        q = pin.integrate(model, np.array(q0), turn)
        for joint in range(1, model.njoints):
            where = joints.configuration_slice(model, joint)
            low, high = q_lower[where], q_upper[where]
            if len(low) == 1 and np.isfinite(low).all() and np.isfinite(high).all():
                q[where] = rng.uniform(low, high)
        found.append(q)
    return found
