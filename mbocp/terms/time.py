"""The weight of the duration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import casadi as ca

from mbocp._keys import Key, Table
from mbocp.terms.cost import Weighted
from mbocp.terms.point import Point
from mbocp.terms.written import NonNegative


@dataclass(frozen=True)
class Time(Weighted):
    """A weight on the duration: 1 and little or no effort ask for minimum time."""

    key = "time"
    over = ""

    class Keys(Table):
        """Keys."""

        time: Annotated[NonNegative, Key("weight of a free duration", "1/s")] = 0.0

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """The weight: the running cost is per second."""
        return p["time"]
