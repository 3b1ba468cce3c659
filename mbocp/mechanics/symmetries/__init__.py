"""Symmetries of a robot: how they are found, and the momenta that they conserve."""

from mbocp.mechanics.symmetries.finding import find_symmetries, momentum_map
from mbocp.mechanics.symmetries.momentum_names import momentum_name

__all__ = ["find_symmetries", "momentum_map", "momentum_name"]
