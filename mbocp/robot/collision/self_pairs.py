"""Pairs of links that may collide with each other."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import combinations
from typing import NamedTuple

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
    """

    spheres: tuple[tuple[tuple[int, int], tuple[int, int]], ...]
    links: tuple[tuple[str, str], ...]
    left_out: dict[str, tuple[tuple[str, str], ...]]


def self_pairs(
    model: pin.Model,
    links: Sequence[LinkSpheres],
    q0: Array,
    limits: tuple[Array, Array],
    disabled: Collection[frozenset[str]] = (),
) -> SelfPairs:
    """Pairs of links that can meet, and do not do so by their build.

    Parameters
    ----------
    model : pin.Model
    links : sequence of LinkSpheres
    q0 : ndarray, shape (nq,)
        Default pose: links whose spheres overlap in it are left out.
    limits : tuple of ndarray, shapes (nq,)
        Range of the poses that are tried.
    disabled : collection of frozenset of str
        Pairs of links by name that are left out.
    """
    placed = _place(model, links, [q0, *_poses(model, q0, *limits)])
    chosen, kept = [], []
    left_out: dict[str, list[tuple[str, str]]] = {}
    for a, b in combinations(range(len(links)), 2):
        names = links[a].link, links[b].link
        gaps = None
        reason = _by_build(model, links[a], links[b], disabled)
        if not reason:
            reach = links[a].radii[:, None] + links[b].radii
            # Poses, spheres of a, spheres of b.
            gaps = np.linalg.norm(placed[a][:, :, None] - placed[b][:, None], axis=3) - reach
            reason = _by_distance(gaps.min(axis=(1, 2)))
        if reason or gaps is None:
            left_out.setdefault(reason, []).append(names)
            continue
        near = np.argwhere(gaps.min(axis=0) <= _RESERVE)
        chosen += [((a, int(i)), (b, int(j))) for i, j in near]
        kept.append(names)
    told = {reason: tuple(pairs) for reason, pairs in left_out.items()}
    return SelfPairs(tuple(chosen), tuple(kept), told)


def _by_build(model: pin.Model, a: LinkSpheres, b: LinkSpheres, disabled: Collection[frozenset[str]]) -> str:
    """Why two links are left out whatever their distance; empty if they are not."""
    if a.joint == b.joint:
        return "moved by one joint"
    if b.joint == model.parents[a.joint] or a.joint == model.parents[b.joint]:
        return "next to each other"
    return "disabled" if frozenset((a.link, b.link)) in disabled else ""


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
