"""What a problem says of configurations that are allowed and that may not be meant."""

from __future__ import annotations

import warnings

import numpy as np

from mbocp._arrays import Array
from mbocp._tolerances import BOUND_TOLERANCE
from mbocp.problem._checks import ProblemWarning
from mbocp.problem.limits import Bounds
from mbocp.robot import Robot
from mbocp.robot.loops.redundancy import singular_pose

__all__ = ["warn_limits", "warn_singular"]

_BESIDE = (
    "the solver may stop at such a singular configuration, and the mechanism go on from it in another "
    "assembly mode: give a pose beside it"
)
_TO_THE_CALLER = 5  # from here over the check, `__post_init__` and `__init__` of the problem


def warn_singular(robot: Robot, q: Array, key: str) -> None:
    """Say that a mechanism is where it may go on in several ways."""
    words = singular_pose(robot, q)
    if words:
        warnings.warn(f"{key}: {words}; {_BESIDE}", ProblemWarning, stacklevel=_TO_THE_CALLER)


def warn_limits(robot: Robot, bounds: Bounds, q: Array, key: str) -> None:
    """Say which coordinates are outside limits of the robot that nobody enforces."""
    if bounds.finite("q").any():
        return
    limits = robot.limits
    lower, upper = limits.position_lower - BOUND_TOLERANCE, limits.position_upper + BOUND_TOLERANCE
    outside = (q < lower) | (q > upper)
    if outside.any():
        names = ", ".join(robot.q_labels[i].name for i in np.flatnonzero(outside))
        message = f"{key}: outside the position limits of {names}; limits are not enforced"
        warnings.warn(message, ProblemWarning, stacklevel=_TO_THE_CALLER)
