"""Masses, inertias and friction of a robot from a recorded motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.identification.exciting import Information as Information
    from mbocp.identification.exciting import information as information
    from mbocp.identification.of_log import Identification as Identification
    from mbocp.identification.of_log import Residuals as Residuals
    from mbocp.identification.of_log import identify as identify
    from mbocp.identification.robot_log import Log as Log
    from mbocp.identification.robot_log import read_log as read_log
    from mbocp.identification.robot_log import write_log as write_log
    from mbocp.identification.simulated_log import simulate_log as simulate_log
    from mbocp.identification.unknown_parameters import BaseParameters as BaseParameters
    from mbocp.identification.unknown_parameters import base_parameters as base_parameters


__getattr__ = names_of(__name__, __file__)
