"""Interval arithmetic on arrays: centres and radii, rounded outwards, see [Rump1999]_."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mbocp._arrays import Array, dataclass

_ROUNDING = 1e-14  # relative: more than the rounding of a product of 20 numbers, and of what NumPy's sine has


@dataclass(frozen=True, eq=False)
class Box:
    """All arrays whose entries differ from those of a centre by no more than radii.

    Attributes
    ----------
    centre, radius : ndarray
        Of one shape; the first axis counts boxes that have nothing to do with each other.
    """

    centre: Array
    radius: Array

    __array_ufunc__ = None  # so that NumPy leaves products with arrays to this class

    @classmethod
    def of(cls, lower: ArrayLike, upper: ArrayLike) -> Box:
        """Enclose what is between two arrays."""
        lo, hi = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
        with np.errstate(invalid="ignore"):
            centre = np.where(np.isfinite(lo) & np.isfinite(hi), (lo + hi) / 2.0, 0.0)
            radius = np.maximum(hi - centre, centre - lo)
        return cls(centre, np.where(lo == hi, 0.0, radius + _bound_rounding(np.abs(lo) + np.abs(hi))))

    @property
    def lower(self) -> Array:
        """Least entries."""
        found: Array = self.centre - self.radius
        return found - _bound_rounding(np.abs(found))

    @property
    def upper(self) -> Array:
        """Greatest entries."""
        found: Array = self.centre + self.radius
        return found + _bound_rounding(np.abs(found))

    @property
    def size(self) -> Array:
        """Greatest absolute values of the entries."""
        found: Array = np.abs(self.centre) + self.radius
        return found * (1.0 + _ROUNDING)

    @property
    def T(self) -> Box:
        """The transposed matrices."""
        return Box(np.swapaxes(self.centre, -1, -2), np.swapaxes(self.radius, -1, -2))

    def within(self, other: Box, more: Array) -> Box:
        """Enclose what is in both, this box and another one whose radii are larger by `more`."""
        low = np.fmax(self.lower, other.lower - more * (1.0 + 1e-12))
        return Box.of(low, np.maximum(low, np.fmin(self.upper, other.upper + more * (1.0 + 1e-12))))

    def __getitem__(self, key: Any) -> Box:
        return Box(self.centre[key], self.radius[key])

    def __neg__(self) -> Box:
        return Box(-self.centre, self.radius)

    def __add__(self, other: Box | Array) -> Box:
        other = _box(other)
        centre = self.centre + other.centre
        return Box(
            centre, self.radius + other.radius + _bound_rounding(np.abs(centre) + self.radius + other.radius)
        )

    def __sub__(self, other: Box | Array) -> Box:
        return self + -_box(other)

    def __mul__(self, other: Box | Array | float) -> Box:
        other = _box(np.asarray(other, dtype=np.float64)) if not isinstance(other, Box) else other
        most = self.size * other.size
        return Box(
            self.centre * other.centre,
            np.abs(self.centre) * other.radius + self.radius * other.size + _bound_rounding(most),
        )

    def __matmul__(self, other: Box | Array) -> Box:
        other = _box(other)
        most = self.size @ other.size
        return Box(
            self.centre @ other.centre,
            np.abs(self.centre) @ other.radius + self.radius @ other.size + _bound_rounding(most),
        )

    def __rmatmul__(self, other: Array) -> Box:
        return _box(other) @ self


def sine(angle: Box) -> Box:
    """Enclose the sines of angles [rad]."""
    is_wide = ~(angle.radius < np.pi)
    lo, hi = (np.where(is_wide, 0.0, side) for side in (angle.lower, angle.upper))
    ends = np.sin(lo), np.sin(hi)
    # Somewhere between is a crest where the number of quarter turns passes 1 modulo 4, a trough at 3.
    crest, trough = (np.floor((hi - s) / (2 * np.pi)) > np.floor((lo - s) / (2 * np.pi)) for s in _CRESTS)
    near = [np.abs((side - s + np.pi) % (2 * np.pi) - np.pi) < _NEAR for s in _CRESTS for side in (lo, hi)]
    top = np.where(crest | near[0] | near[1], 1.0, np.maximum(*ends) + _ROUNDING)
    bottom = np.where(trough | near[2] | near[3], -1.0, np.minimum(*ends) - _ROUNDING)
    bottom, top = np.where(is_wide, -1.0, bottom), np.where(is_wide, 1.0, top)
    return Box.of(np.maximum(bottom, -1.0), np.minimum(top, 1.0))


def cosine(angle: Box) -> Box:
    """Enclose the cosines of angles [rad]."""
    return sine(angle + np.full_like(angle.centre, np.pi / 2.0))


_CRESTS = np.pi / 2.0, -np.pi / 2.0
_NEAR = 1e-9  # [rad] within which rounding decides on which side of a crest an angle is


def _box(value: Box | Array) -> Box:
    return value if isinstance(value, Box) else Box(value, np.zeros_like(value))


def _bound_rounding(size: Array) -> Array:
    return _ROUNDING * size
