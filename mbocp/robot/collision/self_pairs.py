"""Pairs of links that may collide with each other."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot import joints
from mbocp.robot.collision.spheres import LinkSpheres
from mbocp.robot.large import make_working_data

LinkPair = tuple[LinkSpheres, LinkSpheres]

_POSES = 400
_DENSE = 1600  # where shapes decide: with 400 one in twenty poses is kept out in which they are apart
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
        that is so in the default pose, or in one that is given [m].
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
    given: Sequence[Array] = (),
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
    given : sequence of ndarray, shapes (nq,)
        Poses in which links are to be where their shapes let them.
    """
    poses = [q0, *given, *_poses(model, q0, *limits, _POSES)]
    placed = _place(model, links, poses)
    dense: list[Array] = []
    chosen, kept, overlaps = [], [], list[float]()
    left_out: dict[str, list[tuple[str, str]]] = {}
    for a, b in combinations(range(len(links)), 2):
        names = links[a].link, links[b].link
        gaps = None
        reason = _by_build(model, links[a], links[b], disabled)
        if not reason:
            pair = links[a], links[b]
            gaps = _gaps(pair, (placed[a], placed[b]))
            overlap = np.zeros(gaps.shape[1:])
            overlapping = np.flatnonzero(gaps[: 1 + len(given)].min(axis=(1, 2)) < 0.0).tolist()
            if overlapping and _is_in_vain(overlapping, meeting := _Meeting(model, shapes, pair), poses):
                dense = dense or [q0, *given, *_poses(model, q0, *limits, _DENSE)]
                overlap = _overlap(model, pair, meeting, dense)
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


def are_kept_out_in_vain(
    model: pin.Model,
    links: Sequence[LinkSpheres],
    shapes: pin.GeometryModel,
    found: SelfPairs,
    qs: Sequence[Array],
    margin: float,
) -> bool:
    """Whether spheres of links are nearer to each other than a margin [m] where these do not meet."""
    if not found.spheres:
        return False
    first = np.cumsum([0, *(len(link.radii) for link in links)])
    spheres = np.array(found.spheres)
    at = first[spheres[..., 0]] + spheres[..., 1]
    places = np.concatenate(_place(model, links, qs), axis=1)
    reach = np.concatenate([link.radii for link in links])[at].sum(axis=1)
    away = np.linalg.norm(places[:, at[:, 0]] - places[:, at[:, 1]], axis=2) + np.array(found.overlaps)
    for q, is_near in zip(qs, away < reach + margin, strict=True):
        for a, b in np.unique(spheres[is_near, :, 0], axis=0):
            if not _Meeting(model, shapes, (links[a], links[b])).is_at(q):
                return True
    return False


def _is_in_vain(overlapping: Sequence[int], meeting: _Meeting, poses: Sequence[Array]) -> bool:
    """Whether shapes are apart in a pose in which spheres overlap, and in the first, the default."""
    return not meeting.is_at(poses[0]) and any(not meeting.is_at(poses[n]) for n in overlapping)


def _by_build(model: pin.Model, a: LinkSpheres, b: LinkSpheres, disabled: Collection[frozenset[str]]) -> str:
    """Why two links are left out whatever their distance; empty if they are not."""
    if a.joint == b.joint:
        return "moved by one joint"
    if b.joint == model.parents[a.joint] or a.joint == model.parents[b.joint]:
        return "next to each other"
    return "disabled" if frozenset((a.link, b.link)) in disabled else ""


def _gaps(pair: LinkPair, placed: tuple[Array, Array]) -> Array:
    """Distances of the spheres of two links, shape (poses, spheres, spheres) [m]; below 0 they meet."""
    reach = pair[0].radii[:, None] + pair[1].radii
    return np.asarray(np.linalg.norm(placed[0][:, :, None] - placed[1][:, None], axis=3) - reach)


def _overlap(model: pin.Model, pair: LinkPair, meeting: _Meeting, poses: Sequence[Array]) -> Array:
    """How deep spheres of two links are in each other in poses in which their shapes do not meet [m].

    So no pose of these is kept out. Some are let in in which shapes meet: distances of shapes tell there.
    """
    one, other = _place(model, pair, poses)
    gaps = _gaps(pair, (one, other))
    apart = [n for n in np.flatnonzero(gaps.min(axis=(1, 2)) < 0.0).tolist() if not meeting.is_at(poses[n])]
    return np.asarray(np.maximum(-gaps[apart].min(axis=0), 0.0))


class _Meeting:
    """In which poses the shapes of two links meet."""

    def __init__(self, model: pin.Model, shapes: pin.GeometryModel, pair: LinkPair) -> None:
        self._model, self._data, self._shapes = model, make_working_data(model), pin.GeometryModel()
        own: list[list[int]] = [
            [self._shapes.addGeometryObject(s) for s in shapes.geometryObjects if s.parentFrame == link.frame]
            for link in pair
        ]
        for i, j in product(*own):
            self._shapes.addCollisionPair(pin.CollisionPair(i, j))
        self._placed, self._has_shapes = pin.GeometryData(self._shapes), all(own)

    def is_at(self, q: Array) -> bool:
        """Whether they meet in a pose, or a link has none."""
        given = self._model, self._data, self._shapes, self._placed, np.array(q), True
        return not self._has_shapes or bool(pin.computeCollisions(*given))


def _by_distance(nearest: Array) -> str:
    """Why two links are left out by their distances [m] in the default pose and others; empty if not."""
    if nearest[0] < 0.0:
        return "touching in the default pose"
    if (nearest[1:] < 0.0).all():
        return "always touching"
    return "never near each other" if nearest.min() > _RESERVE else ""


def _place(model: pin.Model, links: Sequence[LinkSpheres], qs: Sequence[Array]) -> list[Array]:
    """Centres of each link's spheres in the world, shape (poses, spheres, 3)."""
    data = make_working_data(model)
    found = [np.empty((len(qs), len(link.centers), 3)) for link in links]
    for n, q in enumerate(qs):
        pin.framesForwardKinematics(model, data, np.array(q))
        for link, places in zip(links, found, strict=True):
            at = data.oMf[link.frame]
            places[n] = link.centers @ at.rotation.T + at.translation
    return found


def _poses(model: pin.Model, q0: Array, q_lower: Array, q_upper: Array, count: int) -> list[Array]:
    """Poses within limits, the same every time; what turns without limits turns all the way."""
    rng, found = np.random.default_rng(0), []
    stays, bounded = np.zeros(model.nv, dtype=np.bool_), np.zeros(model.nq, dtype=np.bool_)
    for joint in range(1, model.njoints):
        if model.parents[joint] == 0 and joints.joint_kind(model, joint).word == "floating":
            stays[joints.velocity_slice(model, joint)] = True  # where the whole robot is does not matter
        where = joints.configuration_slice(model, joint)
        if model.nqs[joint] == 1 and np.isfinite([*q_lower[where], *q_upper[where]]).all():
            bounded[where] = True
    for _ in range(count):
        turn = np.where(stays, 0.0, rng.uniform(-np.pi, np.pi, model.nv))
        q = pin.integrate(model, np.array(q0), turn)
        q[bounded] = rng.uniform(q_lower[bounded], q_upper[bounded])
        found.append(q)
    return found
