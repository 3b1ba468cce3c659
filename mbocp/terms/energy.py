"""What a motion spends: energy that motors draw from their supply, with losses of gears, and time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp._keys import Key, Table, Takes
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.terms.cost import CostTableReader, CostWeights, RunningCost, TermNumbers, WeightedCost, shortest
from mbocp.terms.point import Point, Sizes
from mbocp.terms.written import Control, ControlWeights, NonNegative

_KEYS = ("efficiency", "regeneration", "losses", "width")  # rows of the numbers, one column a control
_FORCES = ("N", "N m")
_TINY = 1e-180  # of a square: its root has derivatives where gears lose nothing


class EnergyTable(Table):
    """Motors and gears, each one number for all controls, or one for each."""

    losses: Annotated[
        ControlWeights, Key("of windings: power by the square of the control", "W/N^2, W/(N m)^2")
    ] = 0.0
    efficiency: Annotated[
        Control, Takes("number in (0, 1], list, table"), Key("of the gear, driving and braking alike")
    ] = 1.0
    regeneration: Annotated[
        Control, Takes("number in [0, 1], list, table"), Key("part of the braking power that is given back")
    ] = 0.0
    width: Annotated[
        Control,
        Takes("number > 0, list, table"),
        Key("of the power within which driving goes over into braking", "W"),
    ] = 1.0


@dataclass(frozen=True)
class Energy(RunningCost):
    r"""Energy that the motors draw [J]: losses of their windings, and mechanical power through their gears.

    With the power P of a control, u times the velocity that it acts on, the efficiency eta of its gear and
    the part r of braking power that is given back, a motor takes P / eta where it drives and eta r P where
    it brakes, or

    .. math:: a P + k |P|, \qquad
        a = \frac{1}{2} \left(\frac{1}{\eta} + \eta r\right), \quad
        k = \frac{1}{2} \left(\frac{1}{\eta} - \eta r\right).

    The absolute value is :math:`\sqrt{P^2 + w^2} - w`, by up to the width w less: it is smooth, convex, and
    zero at rest. Losses of the windings are c u^2.
    """

    key = "energy"

    class Keys(Table):
        """Keys."""

        energy: Annotated[
            EnergyTable | None,
            Key(
                "energy [from the supply](recipes.md#energy-from-the-supply) in joules",
                takes="table with `losses`, `efficiency`, `regeneration`, `width`",
            ),
        ] = None

    @classmethod
    def of(cls, given: TermNumbers) -> Energy | None:
        """The term where it is asked for."""
        return cls() if np.any(given.cost.weight(cls.key)) else None

    @classmethod
    def read(cls, table: Any, reader: CostTableReader) -> dict[str, Any]:
        """Rows of the numbers; zeros where there is no such table."""
        written = getattr(table, cls.key)
        if written is None:
            return {cls.key: np.zeros(0)}
        labels = reader.robot.u_labels
        for label in labels:
            if label.unit not in _FORCES:
                raise ProblemError(
                    f"cost.energy: the control {label.name!r} [{label.unit}] is no force and has no power"
                )
        rows = []
        for key in _KEYS:
            row = np.broadcast_to(
                reader.on_controls(getattr(written, key), f"cost.energy.{key}"), len(labels)
            )
            for value, label in zip(row, labels, strict=True):
                _check(key, float(value), label.name)
            rows.append(row)
        return {cls.key: np.array(rows)}

    @classmethod
    def write(cls, cost: CostWeights) -> dict[str, Any]:
        """The table, with one number where it stands for all."""
        rows = np.asarray(cost.weight(cls.key))
        if not rows.any():
            return {}
        return {cls.key: {key: shortest(row) for key, row in zip(_KEYS, rows, strict=True)}}

    @classmethod
    def losses_of(cls, cost: CostWeights) -> Any:
        """Losses of the windings of each motor; 0 where nobody asks for energies."""
        rows = np.asarray(cost.weight(cls.key))
        return rows[_KEYS.index("losses")] if rows.any() else 0.0

    @classmethod
    def compute_drawn_energy(cls, cost: CostWeights, work: Array, braked: Array, squares: Array) -> float:
        """Energy that motors draw over a motion [J], without a width; NaN where nobody asks for energies.

        Parameters
        ----------
        cost : Cost
        work, braked : ndarray, shape (nu,)
            Energy that each control gives, and that it takes up [J].
        squares : ndarray, shape (nu,)
            Integrals of the squares of the controls over time [N^2 s, (N m)^2 s].
        """
        rows = np.asarray(cost.weight(cls.key))
        if not rows.any():
            return math.nan
        efficiency, regeneration, losses, _ = rows
        return float((work / efficiency - efficiency * regeneration * braked + losses * squares).sum())

    def parameters(self, sizes: Sizes) -> dict[str, int]:
        """Numbers a, k, k w and c of each control."""
        return {self.key: 4 * sizes.nu}

    @property
    def weights(self) -> tuple[str, ...]:
        """All of them: with each scaled alike, the cost is."""
        return (self.key,)

    def numbers(self, given: TermNumbers) -> dict[str, Array]:
        """From efficiencies and the like."""
        efficiency, regeneration, losses, width = np.asarray(given.cost.weight(self.key))
        driving, braking = 1.0 / efficiency, efficiency * regeneration
        half = (driving - braking) / 2.0
        return {self.key: np.concatenate([(driving + braking) / 2.0, half, half * width, losses])}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Power that all motors draw [W]."""
        a, k, kw, c = ca.vertsplit(p[self.key], at.mechanics.nu)
        power = at.powers
        through_gears = a * power + ca.sqrt((k * power) ** 2 + kw**2 + _TINY) - kw
        return ca.sum1(through_gears) + ca.dot(c * at.control, at.control)

    def touches(self, given: TermNumbers) -> BoolArray:
        """No component: powers are as symmetric as the robot."""
        return np.zeros(2 * given.robot.nv, dtype=bool)


def _check(key: str, value: float, name: str) -> None:
    allowed = {
        "efficiency": (0.0 < value <= 1.0, "above 0 and up to 1"),
        "regeneration": (0.0 <= value <= 1.0, "from 0 to 1"),
        "losses": (value >= 0.0, "0 or more"),
        "width": (value > 0.0, "above 0"),
    }
    is_right, words = allowed[key]
    if not is_right:
        raise InvalidValue(f"cost.energy.{key}.{name}", value, words)


@dataclass(frozen=True)
class Time(WeightedCost):
    """A weight on the duration: 1 and little or no effort ask for minimum time."""

    key = "time"
    over = ""

    class Keys(Table):
        """Keys."""

        time: Annotated[NonNegative, Key("weight of a free duration", "1/s")] = 0.0

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """The weight: the running cost is per second."""
        return p["time"]
