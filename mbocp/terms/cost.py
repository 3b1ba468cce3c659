"""What a term of the running cost is, and all of them by name.

A class is a kind of term: its keys in the table `[cost]`, the numbers that they stand for, its expression.
An instance is the structure of a term in one problem: all that its functions depend on, and no number. The
numbers are parameters of the functions, which never recompile when one changes.

Defining a class adds it to `COST_TERMS`; schema, parameters, the text of a problem and the documentation
follow from there.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, Protocol

import casadi as ca
import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp._keys import Table
from mbocp.lie import ConfigurationSpace
from mbocp.robot import Robot
from mbocp.terms.own import OwnTerm
from mbocp.terms.point import Point, Sizes

COST_TERMS: list[type[CostTerm]] = []  # in the order of their parameters and of their keys


class CostWeights(Protocol):
    """What terms ask of `mbocp.problem.Cost`."""

    def weight(self, key: str) -> Any:
        """Value of a field, or of a further term."""


class CostTableReader(Protocol):
    """What terms ask of those who read the table `[cost]`: from what is written to arrays."""

    @property
    def robot(self) -> Robot:
        """Whose controls and velocities they are."""

    def on_controls(self, written: Any, key: str) -> Any:
        """Weight of each control, or one number for all."""

    def on_velocities(self, written: Any, key: str) -> Array:
        """Weight of each velocity."""

    def targets(self, target: Any, target_file: str | None) -> tuple[Array, Array, BoolArray]:
        """Configurations and momenta to track, and which directions of (q, p) they say."""

    def goal_says(self) -> BoolArray:
        """Which directions of (q, rate) the goal says."""

    def on_states(self, written: Any, default: BoolArray, key: str) -> Array:
        """Weight of each direction of (q, p)."""

    def check_weighed(self, weights: Array, given: BoolArray, key: str, source: str) -> None:
        """Refuse a weight on a direction that no target says."""


class ForceRows(NamedTuple):
    """Rows of forces of a constraint.

    Attributes
    ----------
    places : tuple of int
        Those among all forces of a step.
    map : tuple of tuple of float, shape (6, rows)
        From them to force and torque on its first frame, in the axes of the second.
    """

    places: tuple[int, ...]
    map: tuple[tuple[float, ...], ...]

    def wrench(self, at: Point) -> ca.SX:
        """Force and torque in a step, shape (6,) [N, N m]."""
        return ca.DM(np.array(self.map)) @ at.constraint_forces()[list(self.places)]


@dataclass(frozen=True)
class TermNumbers:
    """Where the numbers of terms come from."""

    cost: CostWeights
    robot: Robot
    joints: ConfigurationSpace
    num_steps: int
    own: tuple[OwnTerm, ...]
    forces: Mapping[str, ForceRows]  # of constraints that own terms look at, by name


class CostTerm(ABC):
    """A term of the running or terminal cost, see the module.

    Attributes
    ----------
    key : str
        Its name, that of its first key.
    Keys : type of Table
        Its keys in `[cost]`.
    """

    key: ClassVar[str]
    Keys: ClassVar[type[Table]]

    def __init_subclass__(cls) -> None:
        if "key" in cls.__dict__:
            COST_TERMS.append(cls)

    @classmethod
    @abstractmethod
    def read(cls, table: Any, reader: CostTableReader) -> dict[str, Any]:
        """Arguments of `Cost` from a table that has the keys of the term."""

    @classmethod
    @abstractmethod
    def write(cls, cost: CostWeights) -> dict[str, Any]:
        """Keys that read back as the same; none that say nothing."""

    @property
    def signature(self) -> dict[str, Any]:
        """What its functions depend on."""
        return {"term": self.key, **dataclasses.asdict(self)}  # type: ignore[call-overload]


class RunningTerm(ABC):
    """A term of the running cost.

    Attributes
    ----------
    couples_steps : bool
        Whether it weighs the change from one step to the next. Such a term is per step, and there is none
        in the first; others are per second.
    """

    couples_steps: ClassVar[bool] = False

    @property
    @abstractmethod
    def signature(self) -> dict[str, Any]:
        """What its functions depend on."""

    @property
    def uses_time(self) -> bool:
        """Whether it depends on the time itself."""
        return False

    @abstractmethod
    def parameters(self, sizes: Sizes) -> dict[str, int]:
        """Sizes of its parameters of the whole horizon."""

    @property
    @abstractmethod
    def weights(self) -> tuple[str, ...]:
        """Parameters in which it is linear: all of them scaled, the cost is."""

    @abstractmethod
    def numbers(self, given: TermNumbers) -> dict[str, Array]:
        """Values of its parameters of the whole horizon."""

    @abstractmethod
    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Its value at a point, with its parameters by name."""

    def addends(self, at: Point, p: Mapping[str, ca.SX]) -> list[ca.SX]:
        """What is added one after the other to the cost: round-off depends on it."""
        return [self.expression(at, p)]

    def stage_parameters(self, sizes: Sizes) -> dict[str, int]:
        """Sizes of its parameters that have a value for each step."""
        return {}

    def stage_numbers(self, given: TermNumbers) -> dict[str, Array]:
        """Values of these, each of shape (N, size)."""
        return {}

    def touches(self, given: TermNumbers) -> BoolArray:
        """Components of (q, p) that it looks at, shape (2 nv,): symmetries that move one are broken."""
        return np.ones(2 * given.robot.nv, dtype=bool)


class RunningCost(CostTerm, RunningTerm):
    """A term of the running cost with keys in `[cost]`.

    Attributes
    ----------
    over : {"u", "v", ""}
        Whether there is a weight for each control, for each velocity, or what the term says itself.
    is_signed : bool
        Whether weights may be negative.
    """

    over: ClassVar[str] = ""
    is_signed: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def of(cls, given: TermNumbers) -> RunningCost | None:
        """The term as a problem has it, if at all."""


class WeightedCost(RunningCost):
    """A term with nothing but weights, one for each component of what it weighs, or a single one."""

    @classmethod
    def of(cls, given: TermNumbers) -> WeightedCost | None:
        """The term where a weight is not zero."""
        return cls() if np.any(given.cost.weight(cls.key)) else None

    @classmethod
    def read(cls, table: Any, reader: CostTableReader) -> dict[str, Any]:
        """The weights."""
        written, key = getattr(table, cls.key), f"cost.{cls.key}"
        if cls.over == "u":
            return {cls.key: reader.on_controls(written, key)}
        if cls.over == "v":
            return {cls.key: reader.on_velocities(written, key)}
        return {cls.key: written}

    @classmethod
    def write(cls, cost: CostWeights) -> dict[str, Any]:
        """The weights if there are any; of controls one number where it stands for all."""
        weights = np.asarray(cost.weight(cls.key))
        if not weights.any():
            return {}
        return {cls.key: shortest(weights) if cls.over != "v" else weights}

    def parameters(self, sizes: Sizes) -> dict[str, int]:
        """The weights."""
        return {self.key: self.size_over(sizes.nu, sizes.joint_nv)}

    @property
    def weights(self) -> tuple[str, ...]:
        """All that it has."""
        return (self.key,)

    def numbers(self, given: TermNumbers) -> dict[str, Array]:
        """The weights."""
        weights = np.asarray(given.cost.weight(self.key), dtype=np.float64)
        size = self.size_over(given.robot.nu, given.robot.nv)
        return {self.key: np.broadcast_to(weights, (size,))}

    @classmethod
    def size_over(cls, nu: int, nv: int) -> int:
        """Number of weights."""
        return {"u": nu, "v": nv, "": 1}[cls.over]

    def touches(self, given: TermNumbers) -> BoolArray:
        """Momenta of the velocities that it weighs; controls and energies are as symmetric as the robot."""
        nv, mask = given.robot.nv, np.zeros(2 * given.robot.nv, dtype=bool)
        if self.over == "v":
            mask[nv:] = np.asarray(given.cost.weight(self.key)) != 0.0
        return mask


def collect_running_costs(given: TermNumbers) -> tuple[RunningTerm, ...]:
    """Terms of the running cost that the table `[cost]` has, in the order in which they are added."""
    found = (term.of(given) for term in COST_TERMS if issubclass(term, RunningCost))
    return tuple(term for term in found if term is not None)


def shortest(weights: Array) -> Any:
    """One number where it stands for all of them."""
    return float(weights.flat[0]) if (weights == weights.flat[0]).all() else weights


def half_square(weights: ca.SX, x: ca.SX) -> ca.SX:
    """Half the weighted square of a column."""
    return ca.dot(weights * x, x) / 2
