"""What loops and estimators are given, checked: loops that run raise nothing, words say what cannot be."""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem import Problem
from mbocp.problem._checks import check_integer
from mbocp.robot import Robot, load_robot

MICROSECOND = 1e-6  # [s]
MOST_ITERATIONS = 1_000_000  # of one step: more are a mistake, and take minutes


def numbers_of(name: str, value: Any, size: int, wrong: list[str]) -> Array | None:
    """Return finite numbers of shape (size,), no copy of an array; else None, and words."""
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        wrong.append(f"{name}: not an array of numbers")
        return None
    if numbers.shape != (size,):
        wrong.append(f"{name}: got shape {numbers.shape}, expected ({size},)")
    elif np.count_nonzero(np.isfinite(numbers)) < size:
        wrong.append(f"{name}: not finite")
    else:
        return numbers
    return None


def time_of(name: str, value: Any, default: float, unit: str, wrong: list[str]) -> float:
    """Return a time of zero or more, without end where the default is; else the default, and words."""
    try:
        time = default if value is None else float(value)
    except (TypeError, ValueError, OverflowError):
        time = -1.0
    if 0.0 <= time <= max(default, sys.float_info.max):
        return time
    wrong.append(f"{name}: got {value}, expected a time >= 0 [{unit}]")
    return default


def iterations_of(value: Any, default: int, wrong: list[str]) -> int:
    """Return how many Newton steps one step may take; else the default, and words."""
    try:
        return default if value is None else check_integer("iterations", value, 0, MOST_ITERATIONS)
    except InvalidValue as error:
        wrong.append(str(error))
        return default


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
