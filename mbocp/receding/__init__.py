"""A horizon that moves on: an optimal control problem solved again and again, from where the robot is."""

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
