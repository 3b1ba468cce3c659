"""Limits of joints: what files write for none, and what those of mimic joints say of their leaders."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._warn import warn_caller
from mbocp.robot import joints
from mbocp.robot.parts import Limits
from mbocp.robot.warnings import NotModelledWarning

_NO_LIMIT = 1e300  # Pinocchio's "no limit" is the largest double


def limits_of(model: pin.Model, followers: Sequence[Follower], robot: str, efforts: Array) -> Limits:
    """Bounds of the file; zero or contradictory ones mean none, swapped ones are put in order.

    Limits of a follower are limits of its leader, where they leave that one a range.
    """
    velocity = np.array([limit_of(v) for v in model.upperVelocityLimit])
    lower, upper = np.full(model.nq, -np.inf), np.full(model.nq, np.inf)
    for joint in range(1, model.njoints):
        kind, where = joints.joint_kind(model, joint), joints.configuration_slice(model, joint)
        if not (kind.is_vector and kind.q):
            continue
        bounds = np.sort([model.lowerPositionLimit[where], model.upperPositionLimit[where]], axis=0)
        bounds = np.where(np.abs(bounds) > _NO_LIMIT, np.copysign(np.inf, bounds), bounds)
        if (bounds[0] < bounds[1]).all():
            lower[where], upper[where] = bounds
    for follower in followers:
        _limit_leader(model, follower, robot, (velocity, lower, upper))
    return Limits(efforts, velocity, lower, upper)


def _limit_leader(
    model: pin.Model, follower: Follower, robot: str, bounds: tuple[Array, Array, Array]
) -> None:
    """Narrow the leader's bounds, of velocity and position, in place."""
    velocity, lower, upper = bounds
    leader = joints.joint_id(model, follower.leader, robot)
    dof = joints.velocity_slice(model, leader).start
    velocity[dof] = min(velocity[dof], follower.leader_velocity)
    if not joints.joint_kind(model, leader).is_vector:
        return
    at, (low, high) = joints.configuration_slice(model, leader).start, follower.leader_range
    if max(lower[at], low) < min(upper[at], high):
        lower[at], upper[at] = max(lower[at], low), min(upper[at], high)
    else:
        warn_caller(
            f"robot {robot!r}: the position limits of {follower.name!r} leave {follower.leader!r}, "
            "which it mimics, nowhere to move: they are left out",
            NotModelledWarning,
        )


def limit_of(value: float) -> float:
    """A limit of a file: many write zero where none is given."""
    return float(value) if 0.0 < value < _NO_LIMIT else np.inf


@dataclass(frozen=True)
class Follower:
    """A mimic joint: its displacement is ``multiplier * leader's + offset``.

    Attributes
    ----------
    name, leader : str
        Joints; the leader follows no other one.
    multiplier, offset : float
        Of the leader's displacement [rad/rad, m/rad, ...], and [rad, m].
    lower, upper, velocity : float
        Its own limits [rad, m; rad/s, m/s], infinite where there are none.
    damping, friction : float
        Its own [N m s/rad, N s/m; N m, N].
    """

    name: str
    leader: str
    multiplier: float
    offset: float
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    damping: float = 0.0
    friction: float = 0.0

    @property
    def leader_range(self) -> tuple[float, float]:
        """Displacements of the leader between which the follower is within its limits [rad, m]."""
        if self.multiplier == 0.0:
            return -math.inf, math.inf
        ends = [(end - self.offset) / self.multiplier for end in (self.lower, self.upper)]
        return min(ends), max(ends)

    @property
    def leader_velocity(self) -> float:
        """Speed of the leader at which the follower has its greatest [rad/s, m/s]."""
        return self.velocity / abs(self.multiplier) if self.multiplier else math.inf
