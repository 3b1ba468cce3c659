"""Two frames share an axis, and one slides along it as it turns about it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import casadi as ca
import numpy as np
from pydantic import field_validator

from mbocp._arrays import Array, dataclass
from mbocp._measured import Measured
from mbocp.exceptions import InvalidValue
from mbocp.robot.loading.table_reader import TableReader
from mbocp.robot.loading.table_types import Direction, Number
from mbocp.robot.loops.kinds.axes import Axis, Z, along, perpendiculars, unit_axis
from mbocp.robot.loops.kinds.constraint import FrameConstraint, FrameKeys, Kinematics
from mbocp.robot.parts import Label


@dataclass(frozen=True)
class Screw(FrameConstraint):
    r"""Two frames share an axis, and one slides along it as it turns about it: a nut on a spindle.

    With :math:`r = R_b^T (p_a - p_b)`, :math:`R = R_b^T R_a`, :math:`e_1, e_2` across :math:`n_b`, and
    :math:`f_1` the first direction across :math:`n_a`,

    .. math:: \Phi(q) = \begin{pmatrix} e_1^T r \\ e_2^T r \\ e_1^T R n_a \\ e_2^T R n_a \\
        s - h \theta / (2 \pi) \end{pmatrix} \quad [\mathrm{m}, \mathrm{rad}],
        \qquad s = n_b^T r, \quad \theta = \mathrm{atan2}(e_2^T R f_1, e_1^T R f_1).

    The angle is known up to full turns, and the last row up to the pitch h. It takes the turn of the thread
    that is nearest: s says how often the frame has turned, and nobody has to count. Held where it is, r and R
    are those since the hold began, in the axes that frame a had then, and :math:`n_b = n_a`.

    Parameters
    ----------
    name : str
        Appears in messages; the rows are ``name.1``, ``.2``, ``.tilt_1``, ``.tilt_2``, ``.thread``.
    frame_a, frame_b : int
    pitch : float
        h: how far frame a slides along n_b in a turn about n_b [m]; negative for a left-handed thread.
    frames : (str, str)
        Names of the two frames, for messages.
    axis_a, axis_b : (float, float, float)
        n_a in frame a's axes, n_b in frame b's; normalised.
    """

    pitch: float
    frames: tuple[str, str] = ("", "")
    axis_a: Axis = Z
    axis_b: Axis = Z

    kind: ClassVar[str] = "screw"
    hold_keys: ClassVar[Mapping[str, tuple[str, ...]]] = {"axis": ("axis_a", "axis_b"), "pitch": ("pitch",)}

    class Keys(FrameKeys):
        """Two frames share an axis, and the first slides along it as it turns about it."""

        type: Literal["screw"]
        pitch: Annotated[Number, Measured("m")]
        axis: Direction = Z
        axis_b: Direction | None = None

        @field_validator("pitch")
        @classmethod
        def _has_a_thread(cls, pitch: float) -> float:
            if pitch == 0.0:
                raise ValueError("must not be zero; a hinge has no thread")
            return pitch

        def make(self, name: str, where: str, places: TableReader) -> Screw:
            """Make the screw; its axis is the same in both frames if one is given."""
            a, b = places.pair(self.frames, where)
            return Screw(name, a, b, self.pitch, self.frames, self.axis, self.axis_b or self.axis)

    def __post_init__(self) -> None:
        if not math.isfinite(self.pitch) or self.pitch == 0.0:
            raise InvalidValue(f"screw {self.name!r}: pitch", self.pitch, "a finite number other than 0 [m]")
        for key in ("axis_a", "axis_b"):
            object.__setattr__(self, key, unit_axis(getattr(self, key), f"screw {self.name!r}: {key}"))

    @property
    def rows(self) -> tuple[Label, ...]:
        """Two distances across the axis, two tilts, the distance along the thread."""
        across = (Label(f"{self.name}.1", "m"), Label(f"{self.name}.2", "m"))
        tilts = (Label(f"{self.name}.tilt_1", "rad"), Label(f"{self.name}.tilt_2", "rad"))
        return (*across, *tilts, Label(f"{self.name}.thread", "m"))

    @property
    def facts(self) -> dict[str, Any]:
        """Frames and pitch."""
        return {**super().facts, "pitch": self.pitch}

    def equations(self, kinematics: Kinematics, q: ca.SX) -> ca.SX:
        """Place and turn of a in b on the screw about b's axis."""
        return self._rows(self.place(kinematics, q), self.turn(kinematics, q), self.axis_b)

    def change_from(self, kinematics: Kinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Move and turn of a since then on the screw about its own axis."""
        moved = self.turn(kinematics, anchor).T @ self.displacement(kinematics, q, anchor)
        return self._rows(moved, self.turn_since(kinematics, q, anchor), self.axis_a)

    def _rows(self, place: ca.SX, turn: ca.SX, about: Axis) -> ca.SX:
        across, rate = perpendiculars(about), 2.0 * np.pi / self.pitch
        axis, first = (turn @ ca.DM(np.array(e)) for e in (self.axis_a, perpendiculars(self.axis_a)[0]))
        cosine, sine = (along(e, first) for e in across)
        angle = rate * along(about, place)  # that the thread asks for; less that of the turn:
        ahead = ca.atan2(
            ca.sin(angle) * cosine - ca.cos(angle) * sine, ca.cos(angle) * cosine + ca.sin(angle) * sine
        )
        return ca.vertcat(*(along(e, place) for e in across), *(along(e, axis) for e in across), ahead / rate)

    @property
    def wrench_map(self) -> Array:
        """Forces across and along the axis, and the thread's torque; those of the tilts are left out."""
        found = np.zeros((6, 5))
        found[:3, [0, 1, 4]] = -np.array([*perpendiculars(self.axis_b), self.axis_b]).T
        found[3:, 4] = self.pitch / (2.0 * np.pi) * np.array(self.axis_b)
        return found
