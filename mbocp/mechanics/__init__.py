"""Equations of motion of a robot, symbolic in CasADi, by choice of coordinates."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.mechanics.duals import dual_of_momentum, dual_of_velocity, duals_of_momenta
    from mbocp.mechanics.either import Mechanics, Space
    from mbocp.mechanics.joint import JointMechanics, symbols_of
    from mbocp.mechanics.natural_coordinates.mechanics import NaturalMechanics
    from mbocp.mechanics.natural_coordinates.space import NaturalSpace, natural_mechanics

__all__ = [
    "JointMechanics",
    "Mechanics",
    "NaturalMechanics",
    "NaturalSpace",
    "Space",
    "dual_of_momentum",
    "dual_of_velocity",
    "duals_of_momenta",
    "natural_mechanics",
    "symbols_of",
]

__getattr__ = names_of(__name__, __file__)
