"""The stagewise programme, all that a solver sees: functions, parameters, bounds, iterates, the kernel."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.programme.bounds import StateBounds
    from mbocp.programme.iterate import BoundMultipliers, Iterate, zero_multipliers
    from mbocp.programme.stagewise import StageKind, StagewiseProgramme
    from mbocp.programme.units import Units

__all__ = [
    "BoundMultipliers",
    "Iterate",
    "StageKind",
    "StagewiseProgramme",
    "StateBounds",
    "Units",
    "zero_multipliers",
]

__getattr__ = names_of(__name__, __file__)
