"""What holds at the end, or costs something there: the exact goal, accelerations, the terminal cost."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, Any, ClassVar

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp._keys import Key, Table
from mbocp.lie import ConfigurationSpace
from mbocp.terms.cost import CostTableReader, CostTerm, CostWeights, half_square
from mbocp.terms.point import Point, Sizes
from mbocp.terms.written import NonNegative, Weights


@dataclass(frozen=True)
class ExactGoal:
    """End condition of eq. (14), projected onto what the constraints leave free.

    Explicit schemes may leave the groups: their end condition is the null-space projected one, Eq. (37) of
    [Manara2017]_, which is smooth everywhere. Others compare in the tangent space of the goal.

    Attributes
    ----------
    rate : {"v", "p"}
        What it speaks of beside q.
    ng_q, ng_rate : int
        Rows on configuration and rate.
    """

    rate: str
    ng_q: int
    ng_rate: int

    @property
    def rows(self) -> int:
        """Number of conditions."""
        return self.ng_q + self.ng_rate

    @property
    def signature(self) -> dict[str, Any]:
        """What its functions depend on."""
        return {"term": "goal", **dataclasses.asdict(self)}

    def parameters(self, sizes: Sizes) -> dict[str, int]:
        """Goal and projections, the latter by columns."""
        nv = sizes.nv
        return {"q": sizes.nz, "rate": nv, "D_q": self.ng_q * nv, "D_rate": self.ng_rate * nv}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Rows that are zero at the goal."""
        mechanics, nv = at.mechanics, at.mechanics.nv
        return ca.vertcat(
            ca.reshape(p["D_q"], self.ng_q, nv) @ mechanics.end_difference(p["q"], at.q),
            ca.reshape(p["D_rate"], self.ng_rate, nv) @ self.rate_error(at, p),
        )

    def rate_error(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Velocity or momentum less that of the goal."""
        return (at.mechanics.momentum(at.q, at.v) if self.rate == "p" else at.v) - p["rate"]


@dataclass(frozen=True)
class TerminalCost(CostTerm):
    """Terminal cost of eq. (9), with diagonal weights on (q, p), or on (q, v).

    Attributes
    ----------
    q, p : bool
        Whether configuration and rate have weights.
    rate : {"v", "p"}
    parts : tuple of int or None
        Parts of the configuration space that have weights; None: all.
    has_joint_goal : bool
        Whether the end condition speaks of bodies, so that the goal of the joints is needed beside it.
    """

    q: bool
    p: bool
    rate: str
    parts: tuple[int, ...] | None
    has_joint_goal: bool

    key = "terminal"

    class Keys(Table):
        """Keys."""

        terminal: Annotated[NonNegative, Key('beta_T, of a `"penalty"` and `"both"`')] = 0.0
        terminal_weights: Annotated[
            Weights | None,
            Key(
                "diagonal of QT on (q, p), or on (q, v)",
                default="1 where the goal says something",
                weight="terminal",
            ),
        ] = None

    @property
    def signature(self) -> dict[str, Any]:
        """What its functions depend on, in the words that compiled functions are kept under."""
        said = {name: value for name, value in super().signature.items() if name != "has_joint_goal"}
        return {**said, "is_natural": self.has_joint_goal}

    @classmethod
    def of(
        cls, cost: CostWeights, joints: ConfigurationSpace, nv: int, rate: str, *, has_joint_goal: bool
    ) -> TerminalCost | None:
        """The term where it has a weight."""
        weights = np.asarray(cost.weight("terminal_weights"))
        if not (cost.weight("terminal") > 0 and weights.any()):
            return None
        q, p = bool(np.any(weights[:nv])), bool(np.any(weights[nv:]))
        return cls(q, p, rate, joints.find_weighed_parts(weights[:nv]), has_joint_goal)

    @classmethod
    def read(cls, table: Any, reader: CostTableReader) -> dict[str, Any]:
        """Weight and weights."""
        asked, key = reader.goal_says(), "cost.terminal_weights"
        weights = reader.on_states(table.terminal_weights, asked, key)
        if table.terminal > 0.0:
            reader.check_weighed(weights, asked, key, "the goal")
        return {"terminal": table.terminal, "terminal_weights": weights}

    @classmethod
    def write(cls, cost: CostWeights) -> dict[str, Any]:
        """The weight, and where it is not zero the weights."""
        terminal = cost.weight("terminal")
        weights = {"terminal_weights": cost.weight("terminal_weights")} if terminal > 0.0 else {}
        return {"terminal": terminal, **weights}

    def parameters(self, sizes: Sizes) -> dict[str, int]:
        """Diagonals of beta_T Q_T, each followed by what is compared where the end condition does not say."""
        found = {}
        if self.q:
            found["weight_q"] = sizes.joint_nv
            if self.has_joint_goal:
                found["joint_q"] = sizes.joint_nz
        if self.p:
            found["weight_rate"] = sizes.joint_nv
            if self.has_joint_goal:
                found["joint_rate"] = sizes.joint_nv
        return found

    @property
    def weights(self) -> tuple[str, ...]:
        """Both diagonals."""
        return (*(("weight_q",) if self.q else ()), *(("weight_rate",) if self.p else ()))

    @staticmethod
    def numbers(cost: CostWeights, nv: int) -> dict[str, Array]:
        """Diagonals of beta_T Q_T."""
        weights = cost.weight("terminal") * np.asarray(cost.weight("terminal_weights"))
        return {"weight_q": weights[:nv], "weight_rate": weights[nv:]}

    def expression(self, at: Point, goal: ExactGoal, p: Mapping[str, ca.SX]) -> ca.SX:
        """Half the weighted square of the distance from the goal."""
        psi = ca.SX(0)
        if self.q:
            error = at.joint_difference(p["joint_q"] if self.has_joint_goal else p["q"], self.parts)
            psi += half_square(p["weight_q"], error)
        if self.p:
            error = self._joint_rate(at) - p["joint_rate"] if self.has_joint_goal else goal.rate_error(at, p)
            psi += half_square(p["weight_rate"], error)
        return psi

    def _joint_rate(self, at: Point) -> ca.SX:
        return at.joint_velocity() if self.rate == "v" else at.joint_momentum()


@dataclass(frozen=True)
class AccelerationEnd:
    """D (a_N - a*) = 0 with the mean acceleration a_N of the last step, in the unit in which states hold it.

    Attributes
    ----------
    rows : int
        Number of conditions.
    D : ndarray, shape (rows, nv)
        Independent ones among those that are asked for.
    target : ndarray, shape (nv,)
        a* by the unit.
    """

    rows: int
    D: Array = field(compare=False)
    target: Array = field(compare=False)

    remembers: ClassVar[tuple[str, ...]] = ("acceleration",)
    is_cost: ClassVar[bool] = False
    weights: ClassVar[tuple[str, ...]] = ()

    @property
    def signature(self) -> dict[str, Any]:
        """What its functions depend on."""
        return {"term": "acceleration", "rows": self.rows}

    def parameters(self) -> dict[str, int]:
        """The conditions by columns, and their values."""
        return {"acceleration.D": self.D.size, "acceleration.target": len(self.target)}

    def numbers(self) -> dict[str, Array]:
        """Value of each parameter."""
        return {"acceleration.D": self.D.ravel(order="F"), "acceleration.target": np.asarray(self.target)}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Rows that are zero at the goal."""
        missing = at.remembered["acceleration"] - p["acceleration.target"]
        return ca.reshape(p["acceleration.D"], self.rows, len(self.target)) @ missing
