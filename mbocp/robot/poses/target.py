"""What is asked of the pose of a frame: position, orientation, or parts of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from mbocp._arrays import Array, IntArray, dataclass, frozen_array
from mbocp._text import show
from mbocp.exceptions import InvalidValue, suggest
from mbocp.robot.kinematics import WORLD

_MIN_NORM = 1e-8  # below, a direction is noise
_ROUND_OFF = 1e-15  # of a norm: what is written and read again stays as it is
_COORDINATES = ("x", "y", "z")
_WORDS = ("name", "position", *_COORDINATES, "orientation", "rpy", "axis", "direction", "relative_to")


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameTarget:
    """A pose of a frame of a robot, or parts of one.

    Parameters
    ----------
    name : str
        The frame.
    position : array_like, shape (3,), optional
        Where its origin is to be, in the axes of the reference frame [m]; NaN or None: left free.
    orientation : array_like, shape (4,), optional
        Unit quaternion xyzw of its axes in those of the reference frame.
    axis : array_like, shape (3,), optional
        In place of an orientation: an axis in the frame that is to point along `direction`. Any length.
    direction : array_like, shape (3,), optional
        Direction of `axis` in the axes of the reference frame. Any length.
    relative_to : str
        The reference frame.

    Raises
    ------
    DimensionMismatch, InvalidValue
        If a number cannot be right, or nothing is asked for.
    """

    name: str
    position: Array | None = None
    orientation: Array | None = None
    axis: Array | None = None
    direction: Array | None = None
    relative_to: str = WORLD

    def __post_init__(self) -> None:
        if self.position is not None:
            object.__setattr__(self, "position", _position(self._key("position"), self.position))
        for key, size in (("orientation", 4), ("axis", 3), ("direction", 3)):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, _unit(self._key(key), getattr(self, key), size))
        if (self.axis is None) != (self.direction is None):
            given, missing = ("axis", "direction") if self.direction is None else ("direction", "axis")
            raise InvalidValue(self._key(given), f"no {missing}", f"{given} and {missing} together")
        if self.axis is not None and self.orientation is not None:
            raise InvalidValue(self._key("axis"), "axis and orientation", "one of the two")
        if self.name == self.relative_to:
            raise InvalidValue(
                self._key("relative_to"), repr(self.name), "another frame than the one that is to move"
            )

    @classmethod
    def at(cls, name: str, placement: pin.SE3, relative_to: str = WORLD) -> FrameTarget:
        """Ask for a full pose, as `Robot.frame_placement` returns it."""
        quaternion = pin.Quaternion(placement.rotation).coeffs()
        return cls(name=name, position=placement.translation, orientation=quaternion, relative_to=relative_to)

    @property
    def is_empty(self) -> bool:
        """Whether nothing is asked for."""
        return not self.coordinates.size and self.orientation is None and self.axis is None

    @property
    def coordinates(self) -> IntArray:
        """Indices of the coordinates of the origin that are asked for."""
        return np.flatnonzero(np.isfinite(np.full(3, np.nan) if self.position is None else self.position))

    @property
    def rotation(self) -> Array:
        """Matrix of the orientation, shape (3, 3)."""
        x, y, z, w = self.orientation if self.orientation is not None else (0.0, 0.0, 0.0, 1.0)
        return np.array(pin.Quaternion(w, x, y, z).matrix())

    def complete(self, placement: pin.SE3) -> pin.SE3:
        """The pose that is asked for, with what is left free as in a placement in the reference frame."""
        position, rotation = np.array(placement.translation), np.array(placement.rotation)
        if self.position is not None:
            position[self.coordinates] = self.position[self.coordinates]
        if self.orientation is not None:
            rotation = self.rotation
        elif self.axis is not None and self.direction is not None:
            rotation = np.array(pin.exp3(rotation_between(rotation @ self.axis, self.direction))) @ rotation
        return pin.SE3(rotation, position)

    @property
    def words(self) -> str:
        """What is asked for, for a person."""
        parts = []
        if self.position is not None:
            pairs = zip(_COORDINATES, self.position, strict=True)
            parts.append(", ".join(f"{c} = {value:.6g} m" for c, value in pairs if np.isfinite(value)))
        if self.orientation is not None:
            rpy = np.round(pin.rpy.matrixToRpy(self.rotation), 4) + 0.0  # no negative zero
            parts.append(f"rpy {rpy.tolist()} rad")
        if self.axis is not None and self.direction is not None:
            axis, along = (
                np.array2string(v, precision=4, separator=", ") for v in (self.axis, self.direction)
            )
            parts.append(f"axis {axis} along {along}")
        reference = "" if self.relative_to == WORLD else f" in {self.relative_to}"
        return f"{self.name}{reference}: {', '.join(part for part in parts if part)}"

    def _key(self, key: str) -> str:
        return f"frame {self.name!r}: {key}"


Targets: TypeAlias = FrameTarget | Mapping[str, Any] | Sequence[FrameTarget | Mapping[str, Any]]


def targets_of(given: Targets) -> tuple[FrameTarget, ...]:
    """Targets from one or several, each a `FrameTarget` or the words of a problem file's ``[goal.frame]``.

    Raises
    ------
    DimensionMismatch, InvalidValue
        If a word is unknown or a value cannot be right.
    """
    several = [given] if isinstance(given, (FrameTarget, Mapping)) else list(given)
    targets = tuple(t if isinstance(t, FrameTarget) else target_from_words(t) for t in several)
    if not targets or any(target.is_empty for target in targets):
        got = "none" if not targets else f"frame {targets[0].name!r} with neither"
        raise InvalidValue("targets", got, "a position, an orientation, or an axis and its direction")
    return targets


def target_from_words(words: Mapping[str, Any]) -> FrameTarget:
    """Target from name, position or x, y, z, orientation or rpy, axis, direction, relative_to."""
    for word in words:
        if word not in _WORDS:
            raise InvalidValue("targets", show(word), f"other words: {suggest(str(word), _WORDS)}")
    if not isinstance(words.get("name"), str):
        raise InvalidValue("targets: name", show(words.get("name")), "the name of a frame")
    given = {key: words[key] for key in ("orientation", "axis", "direction", "relative_to") if key in words}
    where = f"frame {words['name']!r}"
    if "rpy" in words:
        if "orientation" in words:
            raise InvalidValue(f"{where}: rpy", "rpy and orientation", "one of the two")
        given["orientation"] = _quaternion_of(f"{where}: rpy", words["rpy"])
    return FrameTarget(name=words["name"], position=_position_in(where, words), **given)


def _position_in(where: str, words: Mapping[str, Any]) -> Any:
    """Position, or x, y and z of which some may be missing."""
    position = words.get("position")
    if not any(c in words for c in _COORDINATES):
        return position
    if position is not None:
        raise InvalidValue(f"{where}: position", "position, and x, y or z", "one of the two")
    return [words.get(c) for c in _COORDINATES]


def _quaternion_of(name: str, rpy: Any) -> Array:
    """Unit quaternion xyzw of roll, pitch and yaw [rad]."""
    angles = frozen_array(rpy, shape=(3,), name=name)
    if not np.isfinite(angles).all():
        raise InvalidValue(name, angles.tolist(), "finite numbers [rad]")
    return pin.Quaternion(pin.rpy.rpyToMatrix(*angles)).coeffs()


def rotation_between(a: Array, b: Array) -> Array:
    """Smallest rotation vector that takes the unit vector `a` into `b`, shape (3,) [rad]."""
    normal = pin.skew(a) @ b  # much quicker than np.cross
    sine, cosine = math.sqrt(normal @ normal), float(a @ b)
    if sine > 0.0:
        return normal * (math.atan2(sine, cosine) / sine)
    if cosine > 0.0:
        return np.zeros(3)
    return np.pi * normals_to(a)[:, 0]  # a half-turn about any axis normal to a


def normals_to(direction: Array) -> Array:
    """Two unit vectors normal to a unit vector and to each other, as columns, shape (3, 2)."""
    return np.linalg.svd(direction[None])[2][1:].T


def _position(name: str, value: Any) -> Array:
    numbers = [np.nan if entry is None else entry for entry in value] if not np.isscalar(value) else value
    array = frozen_array(numbers, shape=(3,), name=name)
    if np.isinf(array).any():
        raise InvalidValue(name, array.tolist(), "finite numbers [m], or NaN where the coordinate is free")
    return array


def _unit(name: str, value: ArrayLike, size: int) -> Array:
    array = frozen_array(value, shape=(size,), name=name)
    norm = float(np.linalg.norm(array))
    if not (np.isfinite(norm) and norm > _MIN_NORM):
        what = "a unit quaternion xyzw" if size == 4 else "a direction"
        raise InvalidValue(name, array.tolist(), f"{what}, finite and not zero")
    return frozen_array(array if abs(norm - 1.0) <= _ROUND_OFF else array / norm)
