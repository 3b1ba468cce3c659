"""The origins of two frames coincide."""

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
class Point(FrameConstraint):
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

        def make(self, name: str, where: str, places: TableReader) -> Point:
            """Make the ball joint."""
            return Point(name, *places.pair(self.frames, where), self.frames)

    @property
    def rows(self) -> tuple[Label, ...]:
        """Of the position."""
        return position_rows(self.name)

    def equations(self, kinematics: Kinematics, q: ca.SX) -> ca.SX:
        """Position of a in b."""
        return self.place(kinematics, q)

    def change_from(self, kinematics: Kinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Difference of the positions."""
        return self.displacement(kinematics, q, anchor)

    @property
    def wrench_map(self) -> Array:
        """A force of any direction."""
        return np.vstack([-np.eye(3), np.zeros((3, 3))])
