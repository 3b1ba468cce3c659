"""The origins of two frames coincide, and an axis of one with an axis of the other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.robot.loading.table_reader import TableReader
from mbocp.robot.loading.table_types import Direction
from mbocp.robot.loops.kinds.axes import Axis, Z, along, in_world, perpendiculars, unit_axis
from mbocp.robot.loops.kinds.constraint import FrameConstraint, FrameKeys, Kinematics, position_rows
from mbocp.robot.parts import Label


@dataclass(frozen=True)
class Hinge(FrameConstraint):
    r"""The origins of two frames coincide, and an axis of one with an axis of the other.

    .. math:: \Phi(q) = \begin{pmatrix} R_b^T (p_a - p_b) \\ (R_b e_1)^T R_a n_a \\ (R_b e_2)^T R_a n_a
        \end{pmatrix} \quad [\mathrm{m}, \mathrm{rad}]

    with :math:`e_1, e_2` perpendicular to :math:`n_b`. The axes may point the same way or opposite ways, as
    they do at the start. Held where it is, with :math:`e_1, e_2` across :math:`n_a`, and :math:`E` the turn
    since then, the last rows are :math:`e_i^T E n_a`.

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

    frames: tuple[str, str] = ("", "")
    axis_a: Axis = Z
    axis_b: Axis = Z

    kind: ClassVar[str] = "hinge"
    hold_keys: ClassVar[Mapping[str, tuple[str, ...]]] = {"axis": ("axis_a", "axis_b")}
    fixes_origin: ClassVar[bool] = True

    class Keys(FrameKeys):
        """The origins of two frames coincide, and an axis of one with an axis of the other."""

        type: Literal["hinge"]
        axis: Direction = Z
        axis_b: Direction | None = None

        def make(self, name: str, where: str, places: TableReader) -> Hinge:
            """Make the hinge; its axis is the same in both frames if one is given."""
            a, b = places.pair(self.frames, where)
            return Hinge(name, a, b, self.frames, self.axis, self.axis_b or self.axis)

    def __post_init__(self) -> None:
        for key in ("axis_a", "axis_b"):
            object.__setattr__(self, key, unit_axis(getattr(self, key), f"hinge {self.name!r}: {key}"))

    @property
    def rows(self) -> tuple[Label, ...]:
        """Of the position, and of two tilts."""
        tilts = (Label(f"{self.name}.tilt_1", "rad"), Label(f"{self.name}.tilt_2", "rad"))
        return (*position_rows(self.name), *tilts)

    def equations(self, kinematics: Kinematics, q: ca.SX) -> ca.SX:
        """Position of a in b, and components of a's axis across b's."""
        axes_a, axes_b = (kinematics.frame_rotation(frame, q) for frame in self.frame_ids)
        axis = in_world(axes_a, self.axis_a)
        tilts = [ca.dot(in_world(axes_b, e), axis) for e in perpendiculars(self.axis_b)]
        return ca.vertcat(axes_b.T @ self.offset(kinematics, q), *tilts)

    def change_from(self, kinematics: Kinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Difference of the positions, and components of the axis across where it was."""
        axis = self.turn_since(kinematics, q, anchor) @ ca.DM(np.array(self.axis_a))
        tilts = [along(e, axis) for e in perpendiculars(self.axis_a)]
        return ca.vertcat(self.displacement(kinematics, q, anchor), *tilts)

    @property
    def wrench_map(self) -> Array:
        """A force of any direction; torques of the tilts, whose sign is that of the axes, are left out."""
        return np.vstack([-np.eye(3, 5), np.zeros((3, 5))])
