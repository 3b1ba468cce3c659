"""The origin of one frame stays in a plane of another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.robot.loading.table_reader import TableReader
from mbocp.robot.loading.table_types import Direction
from mbocp.robot.loops.kinds.axes import Axis, Z, along, in_world, unit_axis
from mbocp.robot.loops.kinds.constraint import FrameConstraint, FrameKeys, Kinematics
from mbocp.robot.parts import Label


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

    def equations(self, kinematics: Kinematics, q: ca.SX) -> ca.SX:
        """Distance from the plane."""
        axes_b = kinematics.frame_rotation(self.frame_b, q)
        return ca.dot(in_world(axes_b, self.normal), self.offset(kinematics, q))

    def change_from(self, kinematics: Kinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Difference of the positions along the normal."""
        return along(self.normal, self.displacement(kinematics, q, anchor))

    @property
    def wrench_map(self) -> Array:
        """A force along the normal."""
        found = np.zeros((6, 1))
        found[:3, 0] = -np.array(self.normal)
        return found
