"""What is asked of a frame at the end of the motion: its pose or parts of it, and its velocity."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp.exceptions import DimensionMismatch, InvalidValue
from mbocp.robot import FrameTarget


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameGoal:
    """A goal for a frame of the robot.

    Attributes
    ----------
    target : FrameTarget
        Position and orientation, or parts of them; nothing where only the velocity counts.
    velocity : ndarray, shape (3,), optional
        Velocity of its origin in the axes of the world [m/s].
    angular_velocity : ndarray, shape (3,), optional
        Angular velocity in the axes of the world [rad/s].
    position_tolerance : ndarray, shape (3,), optional
        How far each coordinate may be from the target's at the end; one number stands for all [m].
    orientation_tolerance : float, optional
        Angle by which orientation or axis may be off at the end [rad].
    weight : float
        Of the squares of its errors [m^2, rad^2, m^2/s^2, rad^2/s^2] in the terminal cost.
    """

    target: FrameTarget
    velocity: Array | None = None
    angular_velocity: Array | None = None
    position_tolerance: Array | None = None
    orientation_tolerance: float | None = None
    weight: float = 1.0

    def __post_init__(self) -> None:
        for key in ("velocity", "angular_velocity"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, _rate(f"goal.frame.{key}", getattr(self, key)))
        self._check_tolerances()
        if not (np.isfinite(self.weight) and self.weight >= 0.0):
            raise InvalidValue("goal.frame.weight", self.weight, "a number >= 0")
        if self.target.is_empty and self.velocity is None and self.angular_velocity is None:
            raise InvalidValue(
                "goal.frame",
                f"nothing for {self.target.name!r}",
                "a position, an orientation, an axis with its direction, or a velocity",
            )

    def _check_tolerances(self) -> None:
        target, where = self.target, f"goal.frame {self.target.name!r}"
        if self.position_tolerance is not None:
            given = np.asarray(self.position_tolerance, dtype=np.float64)
            if given.shape not in ((), (3,)):
                raise DimensionMismatch(f"{where}: position_tolerance", given.shape, (3,), "or one number")
            box = np.broadcast_to(given, 3)
            object.__setattr__(self, "position_tolerance", frozen_array(box))
            if not (np.isfinite(box).all() and (box > 0.0).all() and target.coordinates.size):
                got = box.tolist() if target.coordinates.size else "no position beside it"
                expected = "lengths above 0 [m], beside a position"
                raise InvalidValue(f"{where}: position_tolerance", got, expected)
        if self.orientation_tolerance is not None:
            has_turn = target.orientation is not None or target.axis is not None
            if not (0.0 < self.orientation_tolerance < np.pi and has_turn):
                got = self.orientation_tolerance if has_turn else "no orientation or axis beside it"
                expected = "an angle between 0 and pi [rad], beside an orientation or an axis"
                raise InvalidValue(f"{where}: orientation_tolerance", got, expected)

    @property
    def has_tolerance(self) -> bool:
        """Whether some of it is a bound."""
        return self.position_tolerance is not None or self.orientation_tolerance is not None

    @property
    def conditions(self) -> FrameGoal | None:
        """What of it has no tolerance, or None if that is nothing."""
        if not self.has_tolerance:
            return self
        target = self.target
        if self.position_tolerance is not None:
            target = replace(target, position=None)
        if self.orientation_tolerance is not None:
            target = replace(target, orientation=None, axis=None, direction=None)
        if target.is_empty and self.velocity is None and self.angular_velocity is None:
            return None
        return replace(self, target=target, position_tolerance=None, orientation_tolerance=None)

    def move_within(self, rng: np.random.Generator) -> FrameGoal:
        """The goal somewhere within its tolerances."""
        target = self.target
        if self.position_tolerance is not None and target.position is not None:
            aside = self.position_tolerance * rng.uniform(-1.0, 1.0, 3)
            target = replace(target, position=target.position + aside)
        if self.orientation_tolerance is not None:
            axis = rng.standard_normal(3)
            turn = pin.exp3(axis * (self.orientation_tolerance * rng.uniform() / np.linalg.norm(axis)))
            if target.direction is not None:
                target = replace(target, direction=turn @ target.direction)
            else:
                turned = pin.Quaternion(turn @ pin.Quaternion(target.orientation).matrix())
                target = replace(target, orientation=turned.coeffs())
        return replace(self, target=target)

    @property
    def name(self) -> str:
        """The frame."""
        return self.target.name

    @property
    def has_pose(self) -> bool:
        """Whether position or orientation, or a part of them, is asked for."""
        return not self.target.is_empty

    @property
    def rates(self) -> Array:
        """Velocity and angular velocity as far as they are asked for, one after the other."""
        return np.concatenate(
            [np.zeros(0), *(r for r in (self.velocity, self.angular_velocity) if r is not None)]
        )

    @property
    def pose_labels(self) -> tuple[str, ...]:
        """What each row of the pose is."""
        target = self.target
        found = [f"{'xyz'[i]} of {self.name}" for i in target.coordinates]
        if target.orientation is not None:
            found += [f"orientation of {self.name} about its {axis}" for axis in "xyz"]
        elif target.axis is not None:
            found += [f"direction of an axis of {self.name}"] * 2
        return tuple(found)

    @property
    def rate_labels(self) -> tuple[str, ...]:
        """What each row of the rates is."""
        words = (("velocity", self.velocity), ("angular velocity", self.angular_velocity))
        return tuple(
            f"{word} {axis} of {self.name}" for word, value in words if value is not None for axis in "xyz"
        )


def _rate(name: str, value: Any) -> Array:
    array = frozen_array(np.zeros(3) if np.isscalar(value) and value == 0 else value, shape=(3,), name=name)
    if not np.isfinite(array).all():
        raise InvalidValue(name, array.tolist(), "finite numbers")
    return array
