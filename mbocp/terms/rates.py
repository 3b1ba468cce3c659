"""Limits of rates: functions of a state and of what it remembers of the step that led to it.

A class is a kind of limit: its key in `[limits]`, what it is a limit of, what it needs remembered, and its
expression. An instance is the structure of a limit: which entries have bounds. `mbocp.problem.rate_limits`
has the numbers, `mbocp.formulation.features.memory` says how a state remembers.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from mbocp._arrays import dataclass

if TYPE_CHECKING:
    import casadi as ca

    from mbocp.terms.point import Point

RATE_TERMS: dict[str, type[RateTerm]] = {}  # by key, in the order in which they are documented


AT_END = "at the end"
PLACES = {  # where limits may hold beside nodes and means, by key
    "velocity": ("within steps",),
    "acceleration": ("at begins of steps", "at ends of steps"),
    "jerk": ("within steps", AT_END),
    "effort_rate": (AT_END,),
}


def name_at(quantity: str, name: str, place: str) -> str:
    """What the limit of a quantity there is called, beside path constraints."""
    return f"{quantity} of {name} {place}"


@dataclass(frozen=True)
class RateTerm(ABC):
    """A kind of limit, see the module.

    Attributes
    ----------
    key : str
        In `[limits]`.
    letter : str
        Of its bounds in `mbocp.problem.Bounds`.
    over : {"v", "u"}
        Whether it limits something of each velocity or of each control.
    per : int
        Its unit is that of the velocity, or of the control, by this power of a second.
    remembers : tuple of str
        Names of what a state remembers for it.
    needs_joints : bool
        Whether it speaks of the coordinates of the joints, so that states have to be theirs.
    entries : tuple of int
        Of what is remembered, or of the controls: those with bounds.
    """

    entries: tuple[int, ...]

    key: ClassVar[str]
    letter: ClassVar[str]
    over: ClassVar[str]
    per: ClassVar[int] = 1
    remembers: ClassVar[tuple[str, ...]]
    needs_joints: ClassVar[bool] = False
    sizes: ClassVar[Mapping[str, int]] = {"scale": 1}

    def __init_subclass__(cls) -> None:
        if "key" in vars(cls):
            RATE_TERMS[cls.key] = cls

    @property
    def signature(self) -> dict[str, Any]:
        """What its function depends on."""
        return {"rate": self.key, **dataclasses.asdict(self)}

    @property
    def rows(self) -> int:
        """Number of its values."""
        return len(self.entries)

    @classmethod
    def row_name(cls, name: str) -> str:
        """What the limit of one velocity or control is called."""
        return f"{cls.key} of {name}"

    @classmethod
    def unit(cls, unit: str) -> str:
        """Unit of its values, from that of the velocity or control."""
        quantity, _, seconds = unit.partition("/")
        if not seconds:
            return f"{quantity}/s"
        return f"{quantity}/s^{cls.per + 1}"

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Its values, by their scale."""
        return self.values(at)[list(self.entries)] / p["scale"]

    @abstractmethod
    def values(self, at: Point) -> ca.SX:
        """What it limits, of every velocity or control."""


@dataclass(frozen=True)
class AccelerationLimit(RateTerm):
    """Mean acceleration of a step, (v_n - v_{n-1}) / dt."""

    key = "acceleration"
    letter = "a"
    over = "v"
    remembers = ("acceleration",)
    needs_joints = True

    def values(self, at: Point) -> ca.SX:
        """Of every speed [m/s^2, rad/s^2]."""
        return at.remembered["acceleration"]


@dataclass(frozen=True)
class JerkLimit(RateTerm):
    """Change of the mean acceleration from step to step, by the way between their middles.

    In the first step it is that from the acceleration at the start, in half the step.
    """

    key = "jerk"
    letter = "j"
    over = "v"
    per = 2
    remembers: ClassVar[tuple[str, ...]] = ("acceleration", "jerk")
    needs_joints = True

    def values(self, at: Point) -> ca.SX:
        """Of every speed [m/s^3, rad/s^3]."""
        return at.remembered["jerk"]


@dataclass(frozen=True)
class RateAtEnd(RateTerm):
    """Change of a mean of the last step to its value at the end, in half the step.

    Attributes
    ----------
    of : str
        What changes: what a state remembers, and `rates_along` gives, by name.
    """

    of: ClassVar[str]

    @property
    def signature(self) -> dict[str, Any]:
        """What its function depends on."""
        return {**super().signature, "place": "end"}

    @property
    def sizes(self) -> Mapping[str, int]:  # type: ignore[override]
        """Length of the step, or its unit [s]; values at the end."""
        return {**RateTerm.sizes, "length": 1, "goal": self.rows}

    @classmethod
    def row_name(cls, name: str) -> str:
        """What the limit of one velocity or control is called."""
        return name_at(cls.key, name, AT_END)

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Its values, by their scale."""
        left = self.goal(at, p) - self.last(at)[list(self.entries)]
        return left / (p["length"] * at.remembered.get("h", 1.0) / 2.0) / p["scale"]

    def goal(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Values at the end."""
        return p["goal"]

    @abstractmethod
    def last(self, at: Point) -> ca.SX:
        """Means of the last step."""


@dataclass(frozen=True)
class JerkAtEnd(RateAtEnd, JerkLimit):
    """Change of the mean acceleration of the last step to that at the end, in half the step."""

    remembers: ClassVar[tuple[str, ...]] = ("acceleration",)
    of = "acceleration"

    def last(self, at: Point) -> ca.SX:
        """Of every speed [m/s^2, rad/s^2]."""
        return at.remembered["acceleration"]


@dataclass(frozen=True)
class ControlRateLimit(RateTerm):
    """Change of a control from step to step, by the way between their middles.

    In the first step it is that from the control before the start, in half the step; none where it is free.
    """

    key = "effort_rate"
    letter = "du"
    over = "u"
    remembers: ClassVar[tuple[str, ...]] = ("control", "control_rate")

    def values(self, at: Point) -> ca.SX:
        """Of every control [N/s, N m/s]."""
        return at.remembered["control_rate"]


@dataclass(frozen=True)
class ControlRateAtEnd(RateAtEnd, ControlRateLimit):
    """Change of the control of the last step to that after the end, in half the step.

    Attributes
    ----------
    holds : bool
        Whether that is what holds the robot, an open chain with a motor for each joint, where it ends.
    """

    holds: bool = False

    remembers: ClassVar[tuple[str, ...]] = ("control",)
    of = "control"

    def last(self, at: Point) -> ca.SX:
        """Of every control [N, N m]."""
        return at.control

    def goal(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Those of the parameters, or of the configuration."""
        if not self.holds:
            return super().goal(at, p)
        import casadi as ca  # slow to import, and what prints results needs names of limits alone

        from mbocp.mechanics.forces import controls_for

        still = ca.SX.zeros(at.v.numel()), ca.SX.zeros(at.mechanics.nu)
        weight = at.mechanics.gravity(at.q) - at.mechanics.force(at.q, *still)
        return controls_for(at.mechanics, weight)[list(self.entries)]


@dataclass(frozen=True)
class PowerLimit(RateTerm):
    """Power of a control at the end of its step: u times the velocity that it acts on, u_i (B(q)' v)_i."""

    key = "power"
    letter = "power"
    over = "u"
    remembers = ("control",)

    @classmethod
    def unit(cls, unit: str) -> str:
        """Of a force or a torque alike."""
        return "W"

    def values(self, at: Point) -> ca.SX:
        """Of every control [W]."""
        return at.powers
