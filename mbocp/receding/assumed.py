"""What an estimator assumes before the first sample, checked."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem import Problem
from mbocp.robot import Robot, load_robot


def robot_of(given: Robot | Problem | str) -> Robot:
    """Return the robot, which has to be one that estimators know.

    Raises
    ------
    ProblemError
        If it has closed loops or drives.
    """
    robot = load_robot(given) if isinstance(given, str) else getattr(given, "robot", given)
    if not isinstance(robot, Robot):
        raise TypeError(f"robot: got {given!r}, expected a Robot, a Problem or a name")
    for what, is_there in {"closed loops": robot.nc > 0, "drives": bool(robot.drives)}.items():
        if is_there:
            raise ProblemError(f"estimator: robot {robot.name!r} has {what}, which it does not know")
    return robot


def check_whole(robot: Robot, is_unmeasured: BoolArray) -> None:
    """Refuse a part of an attitude or pose: its logarithm needs the rest of it."""
    for name in robot.joint_names:
        of_v, of_q = robot.velocity_indices(name), robot.configuration_indices(name)
        is_vector = of_q.stop - of_q.start == of_v.stop - of_v.start
        if is_unmeasured[of_v].any() and not (is_vector or is_unmeasured[of_v].all()):
            raise ProblemError(
                f"measured.q: joint {name!r} has some components that are inf; give all or none"
            )


def check_words(name: str, given: Mapping[str, Any], known: Collection[str]) -> None:
    """Refuse words that are none of those known."""
    for word in given:
        if word not in known:
            raise ProblemError(f"{name}: got {word!r}, expected some of: {', '.join(known) or 'none'}")


def deviations_of(name: str, value: Any, size: int, *, least: float = 1e-300, most: float = 1e300) -> Array:
    """Numbers of shape (size,), from one or so many."""
    try:
        numbers = np.broadcast_to(np.asarray(value, dtype=np.float64), (size,))
    except (TypeError, ValueError):
        numbers = np.full(size, np.nan)
    if not np.all((numbers >= least) & (numbers <= most)):
        wanted = "positive" if least else "not negative"
        raise InvalidValue(name, value, f"a number that is {wanted}" + f", or {size} of them" * (size > 1))
    return numbers
