"""Joints that close loops: welds, hinges, screws."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import casadi as ca
import numpy as np
from pydantic import field_validator

from mbocp._arrays import Array, dataclass
from mbocp._measured import KeyUnits
from mbocp.exceptions import InvalidValue
from mbocp.robot.loading.table_types import Direction, Number, TableReader
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

    def equations(self, kinematics: FrameKinematics, q: ca.SX) -> ca.SX:
        """Position of a in b, and three products of axes."""
        axes_a, axes_b = (kinematics.frame_rotation(frame, q) for frame in self.frame_ids)
        turns = [ca.dot(axes_a[:, i], axes_b[:, j]) for i, j in ((1, 2), (2, 0), (0, 1))]
        return ca.vertcat(axes_b.T @ self.offset(kinematics, q), *turns)

    def change_from(self, kinematics: FrameKinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Difference of the positions, and the turn since then."""
        E = self.turn_since(kinematics, q, anchor)
        turn = ca.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]) / 2
        return ca.vertcat(self.displacement(kinematics, q, anchor), turn)

    @property
    def wrench_map(self) -> Array:
        """Force and torque of any direction."""
        return -np.eye(6)


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

    def equations(self, kinematics: FrameKinematics, q: ca.SX) -> ca.SX:
        """Position of a in b, and components of a's axis across b's."""
        axes_a, axes_b = (kinematics.frame_rotation(frame, q) for frame in self.frame_ids)
        axis = in_world(axes_a, self.axis_a)
        tilts = [ca.dot(in_world(axes_b, e), axis) for e in perpendiculars(self.axis_b)]
        return ca.vertcat(axes_b.T @ self.offset(kinematics, q), *tilts)

    def change_from(self, kinematics: FrameKinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Difference of the positions, and components of the axis across where it was."""
        axis = self.turn_since(kinematics, q, anchor) @ ca.DM(np.array(self.axis_a))
        tilts = [along(e, axis) for e in perpendiculars(self.axis_a)]
        return ca.vertcat(self.displacement(kinematics, q, anchor), *tilts)

    @property
    def wrench_map(self) -> Array:
        """A force of any direction; torques of the tilts, whose sign is that of the axes, are left out."""
        return np.vstack([-np.eye(3, 5), np.zeros((3, 5))])


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
        pitch: Annotated[Number, KeyUnits("m")]
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

    def equations(self, kinematics: FrameKinematics, q: ca.SX) -> ca.SX:
        """Place and turn of a in b on the screw about b's axis."""
        return self._rows(self.place(kinematics, q), self.turn(kinematics, q), self.axis_b)

    def change_from(self, kinematics: FrameKinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
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
