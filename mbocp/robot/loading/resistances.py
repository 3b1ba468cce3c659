"""Damping and friction of a robot's joints, as far as the equations include them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from mbocp._text import list_names
from mbocp._warn import warn_caller
from mbocp.exceptions import InvalidValue
from mbocp.robot import joints
from mbocp.robot.loading.joint_limits import Follower
from mbocp.robot.resistance import FRICTION_SPEED, JointResistance
from mbocp.robot.warnings import NotModelledWarning

FRICTION_MODELS = ("none", "smooth")
_MAX_NAMES = 6  # in a message


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
        if self.friction is not None and self.friction not in FRICTION_MODELS:
            raise InvalidValue("friction", repr(self.friction), " or ".join(map(repr, FRICTION_MODELS)))
        if not (np.isfinite(self.friction_speed) and self.friction_speed > 0):
            raise InvalidValue("friction_speed", self.friction_speed, "a positive finite number")


def joint_resistances(
    model: pin.Model, followers: Sequence[Follower], losses: Losses, robot: str
) -> tuple[JointResistance, ...]:
    """Losses of a model's joints that are not zero, in the order of the model, then those of followers.

    Parameters
    ----------
    model : pin.Model
        After locking: a locked joint loses nothing. Its `damping` and dry friction limits are the file's.
    followers : sequence of Follower
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
    kept = (_acting(resistance, losses) for resistance in found)
    return tuple(resistance for resistance in kept if resistance.damping or resistance.friction)


def _tell_friction(found: Iterable[JointResistance], losses: Losses, robot: str) -> None:
    rubbing = [resistance.name for resistance in found if resistance.friction]
    if rubbing and losses.friction is None:
        warn_caller(
            f"robot {robot!r}: the Coulomb friction that the URDF gives {list_names(rubbing, _MAX_NAMES)} is "
            'left out; friction = "smooth" takes it in, friction = "none" leaves it out without a word',
            NotModelledWarning,
        )


def _acting(resistance: JointResistance, losses: Losses) -> JointResistance:
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


def _of_followers(model: pin.Model, followers: Sequence[Follower]) -> Iterable[JointResistance]:
    names = list(model.names)
    for follower in followers:
        if follower.multiplier and (follower.damping or follower.friction):
            dof = model.joints[names.index(follower.leader)].idx_v
            yield JointResistance(
                follower.name, dof, follower.multiplier, follower.damping, follower.friction
            )
