"""Limits, damping and friction of joints: what files say, and what those of mimic joints say of leaders."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal, TypeAlias, get_args

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp._text import list_names, warn_caller
from mbocp.exceptions import InvalidValue
from mbocp.robot import joints
from mbocp.robot.parts import Limits
from mbocp.robot.resistance import FRICTION_SPEED, JointResistance
from mbocp.robot.warnings import NotModelledWarning

_NO_LIMIT = 1e300  # Pinocchio's "no limit" is the largest double
FrictionModel: TypeAlias = Literal["none", "smooth"]
_MAX_NAMES = 6  # in a message


def limits_of(model: pin.Model, followers: Sequence[MimicJoint], robot: str, efforts: Array) -> Limits:
    """Bounds of the file; zero or contradictory ones mean none, swapped ones are put in order.

    Limits of a follower are limits of its leader, where they leave that one a range. `efforts` are pairs of
    the least and the largest control, shape (nu, 2).
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
    return Limits(efforts[:, 1], velocity, lower, upper, efforts[:, 0])


def _limit_leader(
    model: pin.Model, follower: MimicJoint, robot: str, bounds: tuple[Array, Array, Array]
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


def range_of(lower: float, upper: float) -> tuple[float, float]:
    """Limits of a file on both sides, likewise."""
    is_range = lower < upper and max(abs(lower), abs(upper)) < _NO_LIMIT
    return (float(lower), float(upper)) if is_range else (-np.inf, np.inf)


@dataclass(frozen=True)
class MimicJoint:
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


@dataclass(frozen=True)
class Losses:
    """Which losses of joints belong into the equations.

    Parameters
    ----------
    damping : bool
        Viscous damping.
    friction : {"none", "smooth"} or None
        Coulomb friction; None: left out, and told.
    friction_speed : float
        w_s [rad/s, m/s].
    joints : frozenset of str, optional
        The joints that it is said of; None: all.
    """

    damping: bool = True
    friction: str | None = None
    friction_speed: float = FRICTION_SPEED
    joints: frozenset[str] | None = None

    def __post_init__(self) -> None:
        if self.friction is not None and self.friction not in (known := get_args(FrictionModel)):
            raise InvalidValue.of_choice("friction", self.friction, known)
        if not (np.isfinite(self.friction_speed) and self.friction_speed > 0):
            raise InvalidValue("friction_speed", self.friction_speed, "a positive finite number")


def joint_resistances(
    model: pin.Model, followers: Sequence[MimicJoint], losses: Losses, robot: str
) -> tuple[JointResistance, ...]:
    """Losses of a model's joints that are not zero, in the order of the model, then those of followers.

    Parameters
    ----------
    model : pin.Model
        After locking: a locked joint loses nothing. Its `damping` and dry friction limits are the file's.
    followers : sequence of MimicJoint
        Mimic joints of the model.
    losses : Losses
    robot : str
        Name for messages.

    Warns
    -----
    NotModelledWarning
        If there is friction, and nothing is said about it.
    """
    every = [*_of_joints(model), *_of_followers(model, followers)]
    found = [each for each in every if losses.joints is None or each.name in losses.joints]
    _tell_friction(found, losses, robot)
    kept = (_with_losses(resistance, losses) for resistance in found)
    return tuple(resistance for resistance in kept if resistance.damping or resistance.friction)


def _tell_friction(found: Iterable[JointResistance], losses: Losses, robot: str) -> None:
    rubbing = [resistance.name for resistance in found if resistance.friction]
    if rubbing and losses.friction is None:
        warn_caller(
            f"robot {robot!r}: the Coulomb friction that its file gives {list_names(rubbing, _MAX_NAMES)} is "
            'left out; friction = "smooth" takes it in, friction = "none" leaves it out without a word',
            NotModelledWarning,
        )


def _with_losses(resistance: JointResistance, losses: Losses) -> JointResistance:
    return replace(
        resistance,
        damping=resistance.damping if losses.damping else 0.0,
        friction=resistance.friction if losses.friction == "smooth" else 0.0,
        speed=losses.friction_speed,
    )


def _of_joints(model: pin.Model) -> Iterable[JointResistance]:
    for joint in range(1, model.njoints):
        where = joints.velocity_slice(model, joint)
        for dof in range(where.start, where.stop):
            damping, friction = float(model.damping[dof]), float(model.upperDryFrictionLimit[dof])
            if damping or friction:
                yield JointResistance(model.names[joint], dof, 1.0, damping, friction)


def _of_followers(model: pin.Model, followers: Sequence[MimicJoint]) -> Iterable[JointResistance]:
    names = list(model.names)
    for follower in followers:
        if follower.multiplier and (follower.damping or follower.friction):
            dof = model.joints[names.index(follower.leader)].idx_v
            yield JointResistance(
                follower.name, dof, follower.multiplier, follower.damping, follower.friction
            )
