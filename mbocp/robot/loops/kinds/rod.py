"""A massless rigid rod between two frames."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import InvalidValue
from mbocp.robot.loading.table_types import Metres, TableReader
from mbocp.robot.loops.kinds.constraint import Axis, FrameConstraint, FrameKeys, FrameKinematics
from mbocp.robot.parts import Label


@dataclass(frozen=True)
class Rod(FrameConstraint):
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

    length: float
    frames: tuple[str, str] = ("", "")

    kind: ClassVar[str] = "rod"
    is_pushing: ClassVar[bool] = True
    connector: ClassVar[str] = "rod"

    class Keys(FrameKeys):
        """A rigid massless rod."""

        type: Literal["rod"]
        length: Metres | None = None

        def make(self, name: str, where: str, places: TableReader) -> Rod:
            """Make the rod; a length that is not given is measured."""
            a, b = places.pair(self.frames, where)
            length = self.length or places.distance(a, b)
            if length <= 0.0:
                places.refuse(
                    f"{where}.length", "not given, and the frames coincide at the initial pose: give a length"
                )
            return Rod(name, a, b, length, self.frames)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.length) and self.length > 0.0):
            raise InvalidValue(f"rod {self.name!r}: length", self.length, "a positive finite number")

    @property
    def rows(self) -> tuple[Label, ...]:
        """The rod's."""
        return (Label(self.name, "m^2"),)

    @property
    def facts(self) -> dict[str, Any]:
        """Frames and length."""
        return {**super().facts, "length": self.length}

    @property
    def own_normal(self) -> Axis:
        """Along the rod."""
        return (1.0, 0.0, 0.0)

    def equations(self, kinematics: FrameKinematics, q: ca.SX) -> ca.SX:
        """Half the difference of the squares of distance and length."""
        d = self.offset(kinematics, q)
        return (ca.dot(d, d) - self.length**2) / 2

    @property
    def wrench_map(self) -> Array:
        """A push along the rod."""
        found = np.zeros((6, 1))
        found[0, 0] = -self.length
        return found
