"""Horizons that move on: one that controls a robot from where it is, and one that estimates where that is."""

from mbocp.receding.estimator import Estimate, MovingHorizonEstimator
from mbocp.receding.horizon import HorizonStep, RecedingHorizon
from mbocp.receding.saved import HEADERS
from mbocp.receding.status import HorizonState, HorizonStatus

__all__ = [
    "HEADERS",
    "Estimate",
    "HorizonState",
    "HorizonStatus",
    "HorizonStep",
    "MovingHorizonEstimator",
    "RecedingHorizon",
]
