"""Terms of the running cost that are linear: in the controls, and in the time itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import casadi as ca

from mbocp.terms.cost import Weighted
from mbocp.terms.point import Point
from mbocp.terms.written import Control, Finite, Key, Table

__all__ = ["LinearEffort", "Time"]


@dataclass(frozen=True)
class LinearEffort(Weighted):
    """The weighted sum of the controls themselves: what thrusters of one direction use up."""

    key = "effort_linear"
    over = "u"
    is_signed = True

    class Keys(Table):
        """Keys."""

        effort_linear: Annotated[
            Control,
            Key(
                "number, list, table",
                "",
                "0",
                "weights of the controls themselves, one for all or one for each; for controls whose limits "
                "keep them on one side of zero",
            ),
        ] = 0.0

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """The weighted sum."""
        return ca.dot(p["effort_linear"], at.control)


@dataclass(frozen=True)
class Time(Weighted):
    """A weight on the duration: 1 and little or no effort ask for minimum time."""

    key = "time"
    over = ""

    class Keys(Table):
        """Keys."""

        time: Annotated[
            Finite,
            Key("number >= 0", "1/s", "0", "weight of the duration, where `horizon.duration` sets it free"),
        ] = 0.0

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """The weight: the running cost is per second."""
        return p["time"]
