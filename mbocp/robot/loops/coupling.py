"""Holonomic constraints between two joints as data, beside those between frames."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from mbocp.exceptions import InvalidValue
from mbocp.robot.parts import Label

__all__ = ["Coupling"]

_INTEGER_TOLERANCE = 1e-12  # a ratio this close to a whole number is one


@dataclass(frozen=True)
class Coupling:
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

    name: str
    joint_a: int
    joint_b: int
    ratio: float
    offset: float = 0.0
    joints: tuple[str, str] = ("", "")
    unit: str = "rad"
    periodic: tuple[bool, bool] = (False, False)

    kind: ClassVar[str] = "coupling"

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
        """Name and unit of each row."""
        return (Label(self.name, self.unit),)
