"""Positions and orientations as people write them: three numbers, and a quaternion or angles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, TypeAlias

import numpy as np
import pinocchio as pin
from pydantic import BeforeValidator

from mbocp._numbers import finite_number, is_number
from mbocp._text import shown

_MIN_NORM = 1e-8  # below, the direction of a quaternion is noise


def _vector(value: Any, counts: tuple[int, ...], expected: str) -> tuple[float, ...]:
    if not isinstance(value, list | tuple) or len(value) not in counts or not all(map(is_number, value)):
        raise ValueError(f"got {shown(value)}, expected {expected}")
    return tuple(finite_number(entry) for entry in value)


def _position(value: Any) -> tuple[float, ...]:
    return _vector(value, (3,), "3 numbers [m]")


def _orientation(value: Any) -> tuple[float, ...]:
    numbers = _vector(value, (3, 4), "a quaternion x, y, z, w, or roll, pitch, yaw [rad]")
    if len(numbers) == 4 and np.linalg.norm(numbers) < _MIN_NORM:
        raise ValueError(f"got {shown(value)}, expected a quaternion that is not zero")
    return numbers


Position: TypeAlias = Annotated[Any, BeforeValidator(_position)]
Orientation: TypeAlias = Annotated[Any, BeforeValidator(_orientation)]


def placement_from(position: Sequence[float], orientation: Sequence[float]) -> pin.SE3:
    """Placement from a position [m] and a quaternion xyzw of any length, or roll, pitch, yaw [rad]."""
    if len(orientation) == 3:
        rotation = pin.rpy.rpyToMatrix(np.array(orientation))
    else:
        rotation = pin.Quaternion(np.array(orientation)).normalized().matrix()
    return pin.SE3(rotation, np.array(position))
