r"""Holonomic constraints as data: rods, closed loops, guides, gears.

Each constraint has a name, a kind, and the names and units of its rows. A frame is an index into
`pin.Model.frames`; frame 0 is the universe, called "world". Frame a has the position p_a and the axes
R_a = (x_a, y_a, z_a) in the world, frame b likewise. `mbocp.robot.loops.equations` writes the equations.

The rows are at most quadratic in the positions and axes of the frames (those of a `Coupling` are linear in
the displacements). Positions are compared in the axes of frame b: what a planar loop keeps then turns with
it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np

from mbocp.exceptions import InvalidValue
from mbocp.robot.loops.coupling import Coupling
from mbocp.robot.parts import Label

__all__ = [
    "Axis",
    "Constraint",
    "FrameConstraint",
    "Hinge",
    "Point",
    "PointOnLine",
    "PointOnPlane",
    "Rod",
    "Weld",
    "perpendiculars",
]

Axis: TypeAlias = tuple[float, float, float]

_Z: Axis = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Rod:
    r"""A massless rigid rod between two frames.

    .. math:: \Phi(q) = \tfrac12 \left(|p_a - p_b|^2 - l^2\right) \quad [\mathrm{m}^2]

    Parameters
    ----------
    name : str
        Appears in messages and as the label of the multiplier.
    frame_a, frame_b : int
        Frames whose origins it joins.
    length : float
        l [m].
    frames : (str, str)
        Names of the two frames, for messages.
    """

    name: str
    frame_a: int
    frame_b: int
    length: float
    frames: tuple[str, str] = ("", "")

    kind: ClassVar[str] = "rod"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.length) and self.length > 0.0):
            raise InvalidValue(f"rod {self.name!r}: length", self.length, "a positive finite number")

    @property
    def rows(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        return (Label(self.name, "m^2"),)


@dataclass(frozen=True)
class Point:
    r"""The origins of two frames coincide: a ball joint that closes a loop.

    .. math:: \Phi(q) = R_b^T (p_a - p_b) \quad [\mathrm{m}]

    Parameters
    ----------
    name : str
        Appears in messages; the rows are ``name.x``, ``name.y``, ``name.z``.
    frame_a, frame_b : int
    frames : (str, str)
        Names of the two frames, for messages.
    """

    name: str
    frame_a: int
    frame_b: int
    frames: tuple[str, str] = ("", "")

    kind: ClassVar[str] = "point"

    @property
    def rows(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        return _position_rows(self.name)


@dataclass(frozen=True)
class Hinge:
    r"""The origins of two frames coincide, and an axis of one with an axis of the other.

    .. math:: \Phi(q) = \begin{pmatrix} R_b^T (p_a - p_b) \\ (R_b e_1)^T R_a n_a \\ (R_b e_2)^T R_a n_a
        \end{pmatrix} \quad [\mathrm{m}, \mathrm{rad}]

    with :math:`e_1, e_2` perpendicular to :math:`n_b`. The axes may point the same way or opposite ways, as
    they do at the start.

    Parameters
    ----------
    name : str
        Appears in messages; the rows are ``name.x``, ``.y``, ``.z``, ``.tilt_1``, ``.tilt_2``.
    frame_a, frame_b : int
    frames : (str, str)
        Names of the two frames, for messages.
    axis_a, axis_b : (float, float, float)
        n_a in frame a's axes, n_b in frame b's; normalised.
    """

    name: str
    frame_a: int
    frame_b: int
    frames: tuple[str, str] = ("", "")
    axis_a: Axis = _Z
    axis_b: Axis = _Z

    kind: ClassVar[str] = "hinge"

    def __post_init__(self) -> None:
        for key in ("axis_a", "axis_b"):
            object.__setattr__(self, key, unit_axis(getattr(self, key), f"hinge {self.name!r}: {key}"))

    @property
    def rows(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        tilts = (Label(f"{self.name}.tilt_1", "rad"), Label(f"{self.name}.tilt_2", "rad"))
        return (*_position_rows(self.name), *tilts)


@dataclass(frozen=True)
class Weld:
    r"""Two frames coincide.

    .. math:: \Phi(q) = \begin{pmatrix} R_b^T (p_a - p_b) \\ y_a^T z_b \\ z_a^T x_b \\ x_a^T y_b \end{pmatrix}
        \quad [\mathrm{m}, \mathrm{rad}]

    The last three are the rotation from b to a, to first order.

    Parameters
    ----------
    name : str
        Appears in messages; the rows are ``name.x``, ``.y``, ``.z``, ``.rx``, ``.ry``, ``.rz``.
    frame_a, frame_b : int
    frames : (str, str)
        Names of the two frames, for messages.
    """

    name: str
    frame_a: int
    frame_b: int
    frames: tuple[str, str] = ("", "")

    kind: ClassVar[str] = "weld"

    @property
    def rows(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        turns = tuple(Label(f"{self.name}.r{axis}", "rad") for axis in "xyz")
        return (*_position_rows(self.name), *turns)


@dataclass(frozen=True)
class PointOnPlane:
    r"""The origin of frame a stays in a plane through the origin of frame b.

    .. math:: \Phi(q) = (R_b n)^T (p_a - p_b) \quad [\mathrm{m}]

    Parameters
    ----------
    name : str
        Appears in messages and as the label of the multiplier.
    frame_a, frame_b : int
    frames : (str, str)
        Names of the two frames, for messages.
    normal : (float, float, float)
        n in frame b's axes; normalised.
    """

    name: str
    frame_a: int
    frame_b: int
    frames: tuple[str, str] = ("", "")
    normal: Axis = _Z

    kind: ClassVar[str] = "plane"

    def __post_init__(self) -> None:
        object.__setattr__(self, "normal", unit_axis(self.normal, f"plane {self.name!r}: normal"))

    @property
    def rows(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        return (Label(self.name, "m"),)


@dataclass(frozen=True)
class PointOnLine:
    r"""The origin of frame a stays on a line through the origin of frame b.

    .. math:: \Phi(q) = (R_b e_i)^T (p_a - p_b), \quad i = 1, 2 \quad [\mathrm{m}]

    with :math:`e_1, e_2` perpendicular to the axis.

    Parameters
    ----------
    name : str
        Appears in messages; the rows are ``name.1``, ``name.2``.
    frame_a, frame_b : int
    frames : (str, str)
        Names of the two frames, for messages.
    axis : (float, float, float)
        Direction of the line in frame b's axes; normalised.
    """

    name: str
    frame_a: int
    frame_b: int
    frames: tuple[str, str] = ("", "")
    axis: Axis = _Z

    kind: ClassVar[str] = "line"

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis", unit_axis(self.axis, f"line {self.name!r}: axis"))

    @property
    def rows(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        return (Label(f"{self.name}.1", "m"), Label(f"{self.name}.2", "m"))


FrameConstraint: TypeAlias = Rod | Point | Hinge | Weld | PointOnPlane | PointOnLine
Constraint: TypeAlias = FrameConstraint | Coupling


def perpendiculars(axis: Axis) -> tuple[Axis, Axis]:
    """Two unit vectors that form a right-handed triad with the unit vector `axis`; x and y for z."""
    n = np.array(axis)
    first = np.eye(3)[int(np.argmin(np.abs(n)))]
    first = first - (first @ n) * n
    first /= np.linalg.norm(first)
    second = np.cross(n, first)
    return _plain(first), _plain(second)


def _position_rows(name: str) -> tuple[Label, ...]:
    return tuple(Label(f"{name}.{axis}", "m") for axis in "xyz")


def unit_axis(axis: Axis, name: str) -> Axis:
    vector = np.array(axis, dtype=np.float64)
    norm = float(np.linalg.norm(vector)) if vector.shape == (3,) else math.nan
    if not (math.isfinite(norm) and norm > 0.0):
        raise InvalidValue(name, axis, "three finite numbers, not all zero")
    return _plain(vector / norm)


def _plain(vector: np.ndarray) -> Axis:
    x, y, z = (float(number) + 0.0 for number in vector)  # without negative zeros
    return x, y, z
