"""Directions in frames: unit vectors, and what is perpendicular to them."""

from __future__ import annotations

import math
from typing import TypeAlias

import casadi as ca
import numpy as np

from mbocp.exceptions import InvalidValue

Axis: TypeAlias = tuple[float, float, float]

Z: Axis = (0.0, 0.0, 1.0)


def unit_axis(axis: Axis, name: str) -> Axis:
    """Normalise a direction. Raises `InvalidValue` if it has none; `name` begins the message."""
    vector = np.array(axis, dtype=np.float64)
    norm = float(np.linalg.norm(vector)) if vector.shape == (3,) else math.nan
    if not (math.isfinite(norm) and norm > 0.0):
        raise InvalidValue(name, axis, "three finite numbers, not all zero")
    return _plain(vector / norm)


def perpendiculars(axis: Axis) -> tuple[Axis, Axis]:
    """Two unit vectors that form a right-handed triad with the unit vector `axis`; x and y for z."""
    n = np.array(axis)
    first = np.eye(3)[int(np.argmin(np.abs(n)))]
    first = first - (first @ n) * n
    first /= np.linalg.norm(first)
    second = np.cross(n, first)
    return _plain(first), _plain(second)


def in_world(axes: ca.SX, direction: Axis) -> ca.SX:
    """Direction in the world of a constant direction in a frame; nothing but a column where it is an axis."""
    terms = [axes[:, i] * number for i, number in enumerate(direction) if number]
    return sum(terms[1:], start=terms[0])


def along(direction: Axis, vector: ca.SX) -> ca.SX:
    """Component of a vector along a constant direction of its axes."""
    return ca.dot(ca.DM(np.array(direction)), vector)


def _plain(vector: np.ndarray) -> Axis:
    x, y, z = (float(number) + 0.0 for number in vector)  # without negative zeros
    return x, y, z
