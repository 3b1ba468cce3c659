"""Equations of motion of a robot, symbolic in CasADi, by choice of coordinates."""

from mbocp.mechanics.duals import dual_of_momentum, dual_of_velocity
from mbocp.mechanics.joint import JointMechanics

__all__ = ["JointMechanics", "dual_of_momentum", "dual_of_velocity"]
