"""Equations of motion of a robot, symbolic in CasADi, by choice of coordinates."""

from typing import TypeAlias

from mbocp.mechanics.duals import dual_of_momentum, dual_of_velocity, duals_of_momenta
from mbocp.mechanics.joint import JointMechanics
from mbocp.mechanics.natural_coordinates.mechanics import NaturalMechanics
from mbocp.mechanics.natural_coordinates.space import NaturalSpace, natural_mechanics

Mechanics: TypeAlias = JointMechanics | NaturalMechanics

__all__ = [
    "JointMechanics",
    "Mechanics",
    "NaturalMechanics",
    "NaturalSpace",
    "dual_of_momentum",
    "dual_of_velocity",
    "duals_of_momenta",
    "natural_mechanics",
]
