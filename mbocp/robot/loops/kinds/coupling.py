"""Two joints move together."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

import casadi as ca
import numpy as np
from pydantic import model_validator

from mbocp._arrays import Array, dataclass
from mbocp._measured import KeyUnits, plain_number
from mbocp.exceptions import InvalidValue, UnsupportedRobot
from mbocp.robot.joints import joint_kind
from mbocp.robot.loading.table_types import FramePair, Number, TableReader
from mbocp.robot.loops.kinds.constraint import Constraint, ConstraintKeys, FrameKinematics
from mbocp.robot.parts import Label

_INTEGER_TOLERANCE = 1e-12  # a ratio this close to a whole number is one


@dataclass(frozen=True)
class Coupling(Constraint):
    r"""Two joints move together: a gear, a rack, a differential's half.

    .. math:: \Phi(q) = \theta_a - r\, \theta_b - c \quad [\mathrm{rad}\ \text{or}\ \mathrm{m}]

    Angles of continuous joints are known up to full turns, and so is then Phi.

    Parameters
    ----------
    name : str
        Appears in messages and as the label of the multiplier.
    joint_a, joint_b : int
        Indices of joints with one displacement each, as in `pin.Model.joints`.
    ratio : float
        r: displacement of a for a unit of b.
    offset : float
        c: displacement of a where b's is zero [rad, m].
    joints : (str, str)
        Names of the two joints, for messages.
    unit : {"rad", "m"}
        Of the displacement of a.
    periodic : (bool, bool)
        Whether the displacements are angles up to full turns (continuous joints).
    """

    joint_a: int
    joint_b: int
    ratio: float
    offset: float = 0.0
    joints: tuple[str, str] = ("", "")
    unit: str = "rad"
    periodic: tuple[bool, bool] = (False, False)

    kind: ClassVar[str] = "coupling"

    class Keys(ConstraintKeys):
        """Two joints move together."""

        type: Literal["coupling"]
        joints: FramePair
        ratio: Number = 1.0
        offset: Annotated[Number, KeyUnits("m, rad")] = 0.0

        @model_validator(mode="after")
        def _two_joints(self) -> Coupling.Keys:
            if self.joints[0] == self.joints[1]:
                raise ValueError(f"joints must be two different joints, got {self.joints[0]!r} twice")
            if self.ratio == 0.0:
                raise ValueError("ratio must not be zero; to hold a joint still, lock it")
            return self

        def make(self, name: str, where: str, places: TableReader) -> Coupling:
            """Make the coupling of joints that have one velocity each."""
            for locked in (joint for joint in self.joints if joint in places.locked):
                places.refuse(
                    f"{where}.joints", f"joint {locked!r} is locked: lock the other, too, or take this out"
                )
            a, b = (places.joint(joint) for joint in self.joints)
            kinds = [joint_kind(places.model, joint) for joint in (a, b)]
            for joint, kind in zip((a, b), kinds, strict=True):
                if len(kind.v) != 1:
                    named = places.model.names[joint]
                    reason = f"joint {named!r} is {kind.word} and has {len(kind.v)} velocities"
                    places.refuse(f"{where}.joints", f"{reason}; a coupling takes joints with one")
            periodic = (not kinds[0].is_vector, not kinds[1].is_vector)
            offset = plain_number(self.offset, kinds[0].v[0][1], f"{where}.offset")
            return Coupling(name, a, b, self.ratio, offset, self.joints, kinds[0].v[0][1], periodic)

    def __post_init__(self) -> None:
        if not math.isfinite(self.ratio) or self.ratio == 0.0:
            raise InvalidValue(f"coupling {self.name!r}: ratio", self.ratio, "a finite number other than 0")
        if not math.isfinite(self.offset):
            raise InvalidValue(f"coupling {self.name!r}: offset", self.offset, "a finite number")
        if self.period is None and any(self.periodic):
            raise InvalidValue(
                f"coupling {self.name!r}: ratio",
                self.ratio,
                f"a whole number or one over a whole number, because the joints {self.joints[0]!r} and "
                f"{self.joints[1]!r} are continuous, known up to full turns only (or make them revolute)",
            )

    @property
    def period(self) -> float | None:
        """Smallest change of Phi that full turns of continuous joints can make; None if there is none."""
        sizes = zip((1.0, abs(self.ratio)), self.periodic, strict=True)
        turns = [2.0 * math.pi * size for size, is_periodic in sizes if is_periodic]
        if not turns:
            return None
        small, large = min(turns), max(turns)
        ratio = large / small
        return small if abs(ratio - round(ratio)) < _INTEGER_TOLERANCE * ratio else None

    @property
    def rows(self) -> tuple[Label, ...]:
        """The difference of the displacements."""
        return (Label(self.name, self.unit),)

    @property
    def joint_ids(self) -> tuple[int, ...]:
        """Joints a and b."""
        return self.joint_a, self.joint_b

    @property
    def facts(self) -> dict[str, Any]:
        """Names of the joints, and how they move together."""
        return {"joints": list(self.joints), "ratio": self.ratio, "offset": self.offset}

    def equations(self, kinematics: FrameKinematics, q: ca.SX) -> ca.SX:
        """Difference of the displacements, up to full turns of continuous joints."""
        theta_a, theta_b = (kinematics.joint_displacement(joint, q) for joint in self.joint_ids)
        value = theta_a - self.ratio * theta_b - self.offset
        if self.period is None:
            return value
        rate = 2.0 * np.pi / self.period
        return ca.atan2(ca.sin(rate * value), ca.cos(rate * value)) / rate

    @property
    def wrench_map(self) -> Array:
        """Refuse: what joins joints exerts no force at a point."""
        raise UnsupportedRobot(
            f"coupling {self.name!r} joins two joints and exerts no force at a point; name a "
            "constraint between frames"
        )
