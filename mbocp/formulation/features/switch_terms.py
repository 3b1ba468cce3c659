"""What functions of stages need of holds, releases and impacts, see `mbocp.integrators.switched`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from mbocp.integrators.switched import Switched
from mbocp.mechanics.held import HeldFrame, held_labels

__all__ = ["ACTIVE", "IS_IMPACT", "NO_SWITCHES", "Switches", "idle_impact"]

ACTIVE = "active"  # the stage parameters e
IS_IMPACT = "is_impact"  # the stage parameter k


@dataclass(frozen=True)
class Switches:
    """What of the constraints can be switched, without the steps in which it is.

    Attributes
    ----------
    held : tuple of HeldFrame
    num_own : int
        Rows of the robot's own constraints where these can be released; else 0.
    has_impacts : bool
    """

    held: tuple[HeldFrame, ...] = ()
    num_own: int = 0
    has_impacts: bool = False

    def __bool__(self) -> bool:
        return bool(self.held or self.num_own or self.has_impacts)

    @property
    def num_held(self) -> int:
        """Rows of the held frames."""
        return len(held_labels(self.held))

    @property
    def stage_parameters(self) -> dict[str, int]:
        """Sizes of what stages are told."""
        rows = self.num_own + self.num_held
        return {**({ACTIVE: rows} if rows else {}), **({IS_IMPACT: 1} if self.has_impacts else {})}

    @property
    def signature(self) -> dict[str, Any]:
        """What the functions of a stage depend on."""
        held = [frame.signature for frame in self.held]
        return {"held": held, "num_own": self.num_own, "has_impacts": self.has_impacts}

    def in_symbols(self, nc: int, given: Mapping[str, ca.SX]) -> Switched:
        """What acts in a step of a robot with `nc` own rows."""
        always = ca.SX.ones(nc - self.num_own)
        active = ca.vertcat(always, given.get(ACTIVE, ca.SX.zeros(0, 1)))
        return Switched(self.held, active, given.get(IS_IMPACT, ca.SX(0)))


NO_SWITCHES = Switches()


def idle_impact(is_impact: ca.SX, u: ca.SX) -> ca.SX:
    """What makes the controls of impacts zero, on which nothing depends."""
    return is_impact * ca.dot(u, u) / 2.0
