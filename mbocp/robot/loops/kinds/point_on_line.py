"""The origin of one frame stays on a line of another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.robot.loading.table_reader import TableReader
from mbocp.robot.loading.table_types import Direction
from mbocp.robot.loops.kinds.axes import Axis, Z, along, in_world, perpendiculars, unit_axis
from mbocp.robot.loops.kinds.constraint import FrameConstraint, FrameKeys, Kinematics
from mbocp.robot.parts import Label


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

    def equations(self, kinematics: Kinematics, q: ca.SX) -> ca.SX:
        """Distances across the line."""
        axes_b, d = kinematics.frame_rotation(self.frame_b, q), self.offset(kinematics, q)
        return ca.vertcat(*[ca.dot(in_world(axes_b, e), d) for e in perpendiculars(self.axis)])

    def change_from(self, kinematics: Kinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Differences of the positions across the line."""
        moved = self.displacement(kinematics, q, anchor)
        return ca.vertcat(*[along(e, moved) for e in perpendiculars(self.axis)])

    @property
    def wrench_map(self) -> Array:
        """Forces across the line."""
        return np.vstack([-np.array(perpendiculars(self.axis)).T, np.zeros((3, 2))])
