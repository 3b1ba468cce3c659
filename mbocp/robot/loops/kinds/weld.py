"""Two frames coincide."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.robot.loading.table_reader import TableReader
from mbocp.robot.loops.kinds.constraint import FrameConstraint, FrameKeys, Kinematics, position_rows
from mbocp.robot.parts import Label


@dataclass(frozen=True)
class Weld(FrameConstraint):
    r"""Two frames coincide.

    .. math:: \Phi(q) = \begin{pmatrix} R_b^T (p_a - p_b) \\ y_a^T z_b \\ z_a^T x_b \\ x_a^T y_b \end{pmatrix}
        \quad [\mathrm{m}, \mathrm{rad}]

    The last three are the rotation from b to a, to first order. Held where it is, they are
    :math:`(E - E^T)^\vee / 2`, with :math:`E` the turn since then.

    Parameters
    ----------
    name : str
        Appears in messages; the rows are ``name.x``, ``.y``, ``.z``, ``.rx``, ``.ry``, ``.rz``.
    frame_a, frame_b : int
    frames : (str, str)
        Names of the two frames, for messages.
    """

    frames: tuple[str, str] = ("", "")

    kind: ClassVar[str] = "weld"
    hold_keys: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    attitude: ClassVar[slice] = slice(3, 6)
    fixes_origin: ClassVar[bool] = True

    class Keys(FrameKeys):
        """Two frames coincide."""

        type: Literal["weld"]

        def make(self, name: str, where: str, places: TableReader) -> Weld:
            """Make the weld."""
            return Weld(name, *places.pair(self.frames, where), self.frames)

    @property
    def rows(self) -> tuple[Label, ...]:
        """Of the position, and of three turns."""
        turns = tuple(Label(f"{self.name}.r{axis}", "rad") for axis in "xyz")
        return (*position_rows(self.name), *turns)

    def equations(self, kinematics: Kinematics, q: ca.SX) -> ca.SX:
        """Position of a in b, and three products of axes."""
        axes_a, axes_b = (kinematics.frame_rotation(frame, q) for frame in self.frame_ids)
        turns = [ca.dot(axes_a[:, i], axes_b[:, j]) for i, j in ((1, 2), (2, 0), (0, 1))]
        return ca.vertcat(axes_b.T @ self.offset(kinematics, q), *turns)

    def change_from(self, kinematics: Kinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Difference of the positions, and the turn since then."""
        E = self.turn_since(kinematics, q, anchor)
        turn = ca.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]) / 2
        return ca.vertcat(self.displacement(kinematics, q, anchor), turn)

    @property
    def wrench_map(self) -> Array:
        """Force and torque of any direction."""
        return -np.eye(6)
