"""Equations of motion of a robot, symbolic in CasADi, by choice of coordinates."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.mechanics.duals import dual_of_momentum as dual_of_momentum
    from mbocp.mechanics.duals import dual_of_velocity as dual_of_velocity
    from mbocp.mechanics.duals import duals_of_momenta as duals_of_momenta
    from mbocp.mechanics.either import Mechanics as Mechanics
    from mbocp.mechanics.either import Space as Space
    from mbocp.mechanics.joint_mechanics import JointMechanics as JointMechanics
    from mbocp.mechanics.joint_mechanics import symbols_of as symbols_of
    from mbocp.mechanics.natural_coordinates.mechanics import NaturalMechanics as NaturalMechanics
    from mbocp.mechanics.natural_coordinates.space import NaturalSpace as NaturalSpace
    from mbocp.mechanics.natural_coordinates.space import natural_mechanics as natural_mechanics


__getattr__ = names_of(__name__, __file__)
