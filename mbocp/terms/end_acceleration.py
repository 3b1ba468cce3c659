"""Accelerations of the joints at the end, as conditions on what the last state remembers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.terms.point import Point


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
