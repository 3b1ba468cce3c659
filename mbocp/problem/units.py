"""Numbers that look like degrees or millimetres, where radians and metres are read."""

from __future__ import annotations

import math
from collections.abc import Iterable

_TURN = 2.0 * math.pi  # [rad]; a smaller number may well be an angle in radians that is a little too large
_TURNS = 2.0 * _TURN  # [rad] beyond which a whole number is no likely angle of a joint without limits
_FAR = 3.0  # [m]: as many millimetres are within the base of most robots
_BEYOND = 0.9  # of the way to a position: the robot reaches less than a tenth of it


def ask_degrees(value: float, lower: float, upper: float, unit: str) -> str:
    """Return the question whether an angle is in degrees; "" where nothing looks like it.

    Parameters
    ----------
    value, lower, upper : float
        Angle and its limits, or numbers of another unit.
    unit : str
    """
    if unit != "rad":
        return ""
    angle = math.radians(value)
    if math.isinf(lower) and math.isinf(upper):
        likely = abs(value) > _TURNS and value == round(value)
    else:
        likely = abs(value) > _TURN and not lower <= value <= upper and lower <= angle <= upper
    return f'is it in degrees? "{value:.6g} deg" is {angle:.4f} rad' if likely else ""


def with_question(message: str, question: str) -> str:
    """Return a message with a question behind it, if there is one."""
    return f"{message}; {question}" if question else message


def ask_millimetres(position: Iterable[float], left: float) -> str:
    """Return the question whether a position is in millimetres; "" where nothing looks like it.

    Parameters
    ----------
    position : iterable of float
        [m], some of which may be NaN.
    left : float
        How far from there the robot remains [m].
    """
    given = [x for x in position if math.isfinite(x)]
    worst, size = max(given, key=abs, default=0.0), math.hypot(*given)
    likely = size > _FAR and left > _BEYOND * size
    return f'is it in millimetres? "{worst:.6g} mm" is {worst / 1e3:.4g} m' if likely else ""
