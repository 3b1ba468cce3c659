"""The stagewise programme, all that a solver sees: functions, parameters, bounds, iterates, the kernel."""

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
