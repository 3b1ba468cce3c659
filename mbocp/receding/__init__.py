"""Horizons that move on: one that controls a robot from where it is, and one that estimates where that is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.receding.estimate import Estimate as Estimate
    from mbocp.receding.estimator import MovingHorizonEstimator as MovingHorizonEstimator
    from mbocp.receding.horizon import HorizonStep as HorizonStep
    from mbocp.receding.horizon import RecedingHorizon as RecedingHorizon
    from mbocp.receding.saved import HEADERS as HEADERS
    from mbocp.receding.status import HorizonState as HorizonState
    from mbocp.receding.status import HorizonStatus as HorizonStatus

__getattr__ = names_of(__name__, __file__)
