"""Equations of motion of a robot, symbolic in CasADi, by choice of coordinates."""

from mbocp.mechanics.joint import JointMechanics

__all__ = ["JointMechanics"]
