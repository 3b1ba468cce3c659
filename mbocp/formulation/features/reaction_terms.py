"""What functions of stages need of the forces of constraints that states remember."""

from __future__ import annotations

import casadi as ca

from mbocp.mechanics import Mechanics

__all__ = ["among_all", "reaction_places"]


def reaction_places(mechanics: Mechanics, rows: tuple[int, ...]) -> list[int]:
    """Places of rows of the robot's constraints among all of a step's: bodies and joints come before them."""
    first = mechanics.nc - mechanics.robot.nc
    return [first + row for row in rows]


def among_all(forces: ca.SX, rows: tuple[int, ...]) -> ca.SX:
    """Forces at their rows, and zeros at those that are not remembered."""
    found = ca.SX.zeros(rows[-1] + 1)
    found[list(rows)] = forces
    return found
