"""The stagewise programme, all that a solver sees: functions, parameters, bounds, iterates, the kernel."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.programme.bounds import StateBounds as StateBounds
    from mbocp.programme.iterate import BoundMultipliers as BoundMultipliers
    from mbocp.programme.iterate import Iterate as Iterate
    from mbocp.programme.iterate import zero_multipliers as zero_multipliers
    from mbocp.programme.stagewise import StageKind as StageKind
    from mbocp.programme.stagewise import StagewiseProgramme as StagewiseProgramme
    from mbocp.programme.stagewise import Units as Units


__getattr__ = names_of(__name__, __file__)
