"""Checks of problems in natural coordinates."""

from __future__ import annotations

from mbocp.exceptions import ProblemError
from mbocp.integrators import EXPLICIT_SCHEMES
from mbocp.mechanics import natural_mechanics
from mbocp.problem.limits import Bounds
from mbocp.robot import Robot

__all__ = ["check_coordinates"]


def check_coordinates(robot: Robot, coordinates: str, scheme: str, limits: Bounds) -> None:
    """Refuse, by name, options that natural coordinates do not have.

    Raises
    ------
    ProblemError
        For explicit schemes and limits on joints.
    UnsupportedRobot
        For joints that natural coordinates do not know.
    """
    if coordinates != "natural":
        return
    if scheme in EXPLICIT_SCHEMES:
        raise ProblemError(
            f'integrator.scheme: got "{scheme}", but natural coordinates are tied by constraints, which are '
            'solved with each step; take "se1", "se2" or "midpoint", or coordinates = "joint"'
        )
    mechanics = natural_mechanics(robot)
    if not mechanics.tree.turning:
        return  # the same as joint coordinates
    for key, table in (("q", "position"), ("v", "velocity")):
        if limits.finite(key).any():
            raise ProblemError(
                f"limits.{table}: natural coordinates have no joint positions and velocities to limit; take "
                'coordinates = "joint", or path constraints'
            )
