"""Points that are kept: at another, on a line, on a plane."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.robot.loading.table_types import Direction, TableReader
from mbocp.robot.loops.kinds.constraint import (
    Axis,
    FrameConstraint,
    FrameKeys,
    FrameKinematics,
    Z,
    along,
    in_world,
    perpendiculars,
    position_rows,
    unit_axis,
)
from mbocp.robot.parts import Label


@dataclass(frozen=True)
class PointOnPoint(FrameConstraint):
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

    frames: tuple[str, str] = ("", "")

    kind: ClassVar[str] = "point"
    hold_keys: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    fixes_origin: ClassVar[bool] = True

    class Keys(FrameKeys):
        """The origins of two frames coincide."""

        type: Literal["point"]

        def make(self, name: str, where: str, places: TableReader) -> PointOnPoint:
            """Make the ball joint."""
            return PointOnPoint(name, *places.pair(self.frames, where), self.frames)

    @property
    def rows(self) -> tuple[Label, ...]:
        """Of the position."""
        return position_rows(self.name)

    def equations(self, kinematics: FrameKinematics, q: ca.SX) -> ca.SX:
        """Position of a in b."""
        return self.place(kinematics, q)

    def change_from(self, kinematics: FrameKinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Difference of the positions."""
        return self.displacement(kinematics, q, anchor)

    @property
    def wrench_map(self) -> Array:
        """A force of any direction."""
        return np.vstack([-np.eye(3), np.zeros((3, 3))])


@dataclass(frozen=True)
class PointOnLine(FrameConstraint):
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

    frames: tuple[str, str] = ("", "")
    axis: Axis = Z

    kind: ClassVar[str] = "line"
    hold_keys: ClassVar[Mapping[str, tuple[str, ...]]] = {"axis": ("axis",)}
    is_directed: ClassVar[bool] = True

    class Keys(FrameKeys):
        """The origin of the first frame stays on a line of the second."""

        type: Literal["line"]
        axis: Direction = Z

        def make(self, name: str, where: str, places: TableReader) -> PointOnLine:
            """Make the line."""
            return PointOnLine(name, *places.pair(self.frames, where), self.frames, self.axis)

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis", unit_axis(self.axis, f"line {self.name!r}: axis"))

    @property
    def rows(self) -> tuple[Label, ...]:
        """Two distances across the line."""
        return (Label(f"{self.name}.1", "m"), Label(f"{self.name}.2", "m"))

    def equations(self, kinematics: FrameKinematics, q: ca.SX) -> ca.SX:
        """Distances across the line."""
        axes_b, d = kinematics.frame_rotation(self.frame_b, q), self.offset(kinematics, q)
        return ca.vertcat(*[ca.dot(in_world(axes_b, e), d) for e in perpendiculars(self.axis)])

    def change_from(self, kinematics: FrameKinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Differences of the positions across the line."""
        moved = self.displacement(kinematics, q, anchor)
        return ca.vertcat(*[along(e, moved) for e in perpendiculars(self.axis)])

    @property
    def wrench_map(self) -> Array:
        """Forces across the line."""
        return np.vstack([-np.array(perpendiculars(self.axis)).T, np.zeros((3, 2))])


@dataclass(frozen=True)
class PointOnPlane(FrameConstraint):
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

    frames: tuple[str, str] = ("", "")
    normal: Axis = Z

    kind: ClassVar[str] = "plane"
    hold_keys: ClassVar[Mapping[str, tuple[str, ...]]] = {"axis": ("normal",)}
    is_directed: ClassVar[bool] = True

    class Keys(FrameKeys):
        """The origin of the first frame stays in a plane of the second."""

        type: Literal["plane"]
        normal: Direction = Z

        def make(self, name: str, where: str, places: TableReader) -> PointOnPlane:
            """Make the plane."""
            return PointOnPlane(name, *places.pair(self.frames, where), self.frames, self.normal)

    def __post_init__(self) -> None:
        object.__setattr__(self, "normal", unit_axis(self.normal, f"plane {self.name!r}: normal"))

    @property
    def rows(self) -> tuple[Label, ...]:
        """The distance from the plane."""
        return (Label(self.name, "m"),)

    @property
    def own_normal(self) -> Axis:
        """That of the plane."""
        return self.normal

    def equations(self, kinematics: FrameKinematics, q: ca.SX) -> ca.SX:
        """Distance from the plane."""
        axes_b = kinematics.frame_rotation(self.frame_b, q)
        return ca.dot(in_world(axes_b, self.normal), self.offset(kinematics, q))

    def change_from(self, kinematics: FrameKinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Difference of the positions along the normal."""
        return along(self.normal, self.displacement(kinematics, q, anchor))

    @property
    def wrench_map(self) -> Array:
        """A force along the normal."""
        found = np.zeros((6, 1))
        found[:3, 0] = -np.array(self.normal)
        return found
