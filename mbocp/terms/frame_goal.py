"""What is asked of a frame at the end of the motion: its pose or parts of it, and its velocity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.exceptions import InvalidValue
from mbocp.robot import FrameTarget

__all__ = ["RATE_KEYS", "FrameGoal"]

RATE_KEYS = ("velocity", "angular_velocity", "weight")  # of a file, beside those of the pose


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
    weight : float
        Of the squares of its errors [m^2, rad^2, m^2/s^2, rad^2/s^2] in the terminal cost.
    """

    target: FrameTarget
    velocity: Array | None = None
    angular_velocity: Array | None = None
    weight: float = 1.0

    def __post_init__(self) -> None:
        for key in ("velocity", "angular_velocity"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, _rate(f"goal.frame.{key}", getattr(self, key)))
        if not (np.isfinite(self.weight) and self.weight >= 0.0):
            raise InvalidValue("goal.frame.weight", self.weight, "a number >= 0")
        if self.target.is_empty and self.velocity is None and self.angular_velocity is None:
            raise InvalidValue(
                "goal.frame",
                f"nothing for {self.target.name!r}",
                "a position, an orientation, an axis with its direction, or a velocity",
            )

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
