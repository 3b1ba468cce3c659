"""What all kinds of constraints between bodies have in common.

A kind is one class: its keys in a robot.toml, names and units of its rows, its equations, what
its multipliers exert, and what others ask of it (a hold, a picture, a bound on forces). A frame is an index
into `pin.Model.frames`; frame 0 is the universe, called "world". Frame a has the position p_a and the axes
R_a = (x_a, y_a, z_a) in the world, frame b likewise. Positions are compared in the axes of frame b: what a
planar loop keeps then turns with it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeAlias

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import InvalidValue
from mbocp.robot.loading.table_types import FrozenTable, Orientation, PairTable, Position, TableReader
from mbocp.robot.parts import Label

Axis: TypeAlias = tuple[float, float, float]

Z: Axis = (0.0, 0.0, 1.0)


def unit_axis(axis: Axis, name: str) -> Axis:
    """Normalise a direction. Raises `InvalidValue` if it has none; `name` begins the message."""
    vector = np.array(axis, dtype=np.float64)
    norm = float(np.linalg.norm(vector)) if vector.shape == (3,) else math.nan
    if not (math.isfinite(norm) and norm > 0.0):
        raise InvalidValue(name, axis, "three finite numbers, not all zero")
    return _plain(vector / norm)


def perpendiculars(axis: Axis) -> tuple[Axis, Axis]:
    """Two unit vectors that form a right-handed triad with the unit vector `axis`; x and y for z."""
    n = np.array(axis)
    first = np.eye(3)[int(np.argmin(np.abs(n)))]
    first = first - (first @ n) * n
    first /= np.linalg.norm(first)
    second = np.cross(n, first)
    return _plain(first), _plain(second)


def in_world(axes: ca.SX, direction: Axis) -> ca.SX:
    """Direction in the world of a constant direction in a frame; nothing but a column where it is an axis."""
    terms = [axes[:, i] * number for i, number in enumerate(direction) if number]
    return sum(terms[1:], start=terms[0])


def along(direction: Axis, vector: ca.SX) -> ca.SX:
    """Component of a vector along a constant direction of its axes."""
    return ca.dot(ca.DM(np.array(direction)), vector)


def _plain(vector: np.ndarray) -> Axis:
    x, y, z = (float(number) + 0.0 for number in vector)  # without negative zeros
    return x, y, z


class FrameKinematics(Protocol):
    """Where frames and joints are, as expressions in a configuration q of any coordinates."""

    def frame_position(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Position of a frame's origin in the world, shape (3,) [m]."""

    def frame_rotation(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Axes of a frame in the world, shape (3, 3)."""

    def joint_displacement(self, joint_id: int, q: ca.SX) -> ca.SX:
        """Angle or length of a joint that has one displacement [rad, m]."""


class ConstraintKeys(FrozenTable):
    """Keys of a `[[constraint]]` that every kind has."""

    name: str | None = None
    if TYPE_CHECKING:
        type: str  # each kind has its own word, last among its keys

    @property
    def placements(self) -> tuple[tuple[str, Any, Any], ...]:
        """Frame, position and orientation of each end that may be placed in its frame."""
        return ()

    @abstractmethod
    def make(self, name: str, where: str, places: TableReader) -> Constraint:
        """Make the constraint; `where` names the table in messages.

        Raises
        ------
        RobotFileError, UnknownFrame, UnknownJoint
        """


class FrameKeys(PairTable, ConstraintKeys):
    """Two frames that are joined, and where in each of them the joint is."""

    position: Position | None = None
    orientation: Orientation | None = None
    position_b: Position | None = None
    orientation_b: Orientation | None = None

    @property
    def placements(self) -> tuple[tuple[str, Any, Any], ...]:
        """Both ends."""
        a, b = self.frames
        return (a, self.position, self.orientation), (b, self.position_b, self.orientation_b)


@dataclass(frozen=True)
class Constraint(ABC):
    r"""Equations Phi(q) = 0 that hold at all times.

    Attributes
    ----------
    kind : str
        What it is called in files and messages.
    Keys : type
        Keys of its table.
    attitude : slice, optional
        Rows that keep all axes of the frames together, as the rotation vector between them does to first
        order. They vanish at half turns, too.
    fixes_origin : bool
        Whether the origin of frame a cannot move in frame b.
    is_directed : bool
        Whether directions of frame b matter to it even where a hold keeps what is there.
    is_pushing : bool
        Whether its force is along the way between the frames.
    connector : {"rod", "spring", "line"}, optional
        What a picture draws between its frames.
    """

    name: str

    kind: ClassVar[str]
    Keys: ClassVar[type[ConstraintKeys]]
    attitude: ClassVar[slice | None] = None
    fixes_origin: ClassVar[bool] = False
    is_directed: ClassVar[bool] = False
    is_pushing: ClassVar[bool] = False
    connector: ClassVar[str | None] = None

    @property
    @abstractmethod
    def rows(self) -> tuple[Label, ...]:
        """Name and unit of each row."""

    @property
    def frame_ids(self) -> tuple[int, ...]:
        """Frames a and b; none if it joins joints."""
        return ()

    @property
    def joint_ids(self) -> tuple[int, ...]:
        """Joints whose displacements it joins."""
        return ()

    @property
    def own_normal(self) -> Axis | None:
        """Direction of the only force that it exerts, as `wrench_map` has it; None if there are several."""
        return None

    @property
    @abstractmethod
    def facts(self) -> dict[str, Any]:
        """What it joins and how, JSON-able."""

    @abstractmethod
    def equations(self, kinematics: FrameKinematics, q: ca.SX) -> ca.SX:
        """Phi(q), shape (len(rows),), in whatever coordinates `kinematics` has."""

    def change_from(self, kinematics: FrameKinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Phi(q; anchor): zero where what it keeps is as it was at another configuration."""
        return self.equations(kinematics, q) - self.equations(kinematics, anchor)

    @property
    @abstractmethod
    def wrench_map(self) -> Array:
        r"""From the multipliers of all rows to force and torque on frame a, shape (6, rows) [N, N m].

        The equations of motion are :math:`M a = f - \Phi_q^T \lambda`. So the force that frame b, or what
        carries it, exerts on frame a at its origin is :math:`-R_b\,\partial\Phi/\partial p\;\lambda`, with p
        the position of a's origin in the axes of b, where the rows are written. Both are in the axes of frame
        b, the torque about the origin of frame a; exact where the constraint holds. Where `is_pushing`, there
        are no axes of b: the force stands in the first component, along the way, positive where it pushes.

        Raises
        ------
        UnsupportedRobot
            If it joins joints, which has no force at a point.
        """


@dataclass(frozen=True)
class FrameConstraint(Constraint):
    """A constraint between two frames.

    Attributes
    ----------
    hold_keys : mapping of str to tuple of str, optional
        Keys that a hold of this kind has beside its frames, and the fields that have the value of each; None
        if there is no such hold.
    """

    frame_a: int
    frame_b: int

    hold_keys: ClassVar[Mapping[str, tuple[str, ...]] | None] = None

    @property
    @abstractmethod
    def frames(self) -> tuple[str, str]:
        """Names of the two frames, for messages."""

    @property
    def frame_ids(self) -> tuple[int, ...]:
        """Frames a and b."""
        return self.frame_a, self.frame_b

    @property
    def facts(self) -> dict[str, Any]:
        """Names of the frames."""
        return {"frames": list(self.frames)}

    @classmethod
    def for_hold(
        cls, name: str, frame_ids: tuple[int, int], frames: tuple[str, str], given: Mapping[str, Any]
    ) -> FrameConstraint:
        """Make what a hold keeps, from the values of `hold_keys`."""
        fields = {field: given[key] for key, of_key in (cls.hold_keys or {}).items() for field in of_key}
        return cls(name, *frame_ids, frames=frames, **fields)  # type: ignore[call-arg]  # fields of kinds

    def offset(self, kinematics: FrameKinematics, q: ca.SX) -> ca.SX:
        """Origin of frame a from that of frame b in the world [m]."""
        return kinematics.frame_position(self.frame_a, q) - kinematics.frame_position(self.frame_b, q)

    def place(self, kinematics: FrameKinematics, q: ca.SX) -> ca.SX:
        """Origin of frame a from that of frame b, in the axes of b [m]."""
        between = self.offset(kinematics, q)
        return kinematics.frame_rotation(self.frame_b, q).T @ between

    def turn(self, kinematics: FrameKinematics, q: ca.SX) -> ca.SX:
        """Axes of frame a in those of frame b."""
        axes = kinematics.frame_rotation(self.frame_b, q)
        return axes.T @ kinematics.frame_rotation(self.frame_a, q)

    def displacement(self, kinematics: FrameKinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
        """How far the origin of frame a is from where it was, in the axes of b [m]."""
        return self.place(kinematics, q) - self.place(kinematics, anchor)

    def turn_since(self, kinematics: FrameKinematics, q: ca.SX, anchor: ca.SX) -> ca.SX:
        """How far frame a is turned from where it was, in its axes there."""
        return self.turn(kinematics, anchor).T @ self.turn(kinematics, q)


def position_rows(name: str) -> tuple[Label, ...]:
    """Name and unit of the rows of a position."""
    return tuple(Label(f"{name}.{axis}", "m") for axis in "xyz")
