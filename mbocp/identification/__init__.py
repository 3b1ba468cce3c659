"""Masses, inertias and friction of a robot from a recorded motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.identification.base import BaseParameters, base_parameters
    from mbocp.identification.exciting import Information, excite, information
    from mbocp.identification.log import Log, read_log, write_log
    from mbocp.identification.of_log import Identification, Residuals, identify
    from mbocp.identification.simulated import simulate_log

__all__ = [
    "BaseParameters",
    "Identification",
    "Information",
    "Log",
    "Residuals",
    "base_parameters",
    "excite",
    "identify",
    "information",
    "read_log",
    "simulate_log",
    "write_log",
]

__getattr__ = names_of(__name__, __file__)
