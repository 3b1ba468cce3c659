"""The elementary checks that every part of a problem shares."""

from __future__ import annotations

from collections.abc import Sequence

from mbocp._arrays import Array
from mbocp._checks import (
    check_bool,
    check_choice,
    check_finite,
    check_integer,
    check_non_negative,
    check_number,
    check_positive,
)
from mbocp.exceptions import InvalidValue
from mbocp.robot.parts import Label

__all__ = [
    "MAX_POSITION",
    "MAX_RATE",
    "ProblemWarning",
    "check_bool",
    "check_choice",
    "check_finite",
    "check_integer",
    "check_non_negative",
    "check_number",
    "check_positive",
    "check_size",
]

MAX_POSITION = 1e9  # [m, rad] as in replays; a float of this size is exact to 1e-7
MAX_RATE = 1e15  # [m/s, rad/s, kg m/s, N m s] as of the numbers of a robot; products of several have numbers


class ProblemWarning(UserWarning):
    """Something about a problem that is allowed, but probably not meant."""


def check_size(key: str, value: Array, labels: Sequence[Label], largest: float) -> None:
    """Refuse a state so large that the mechanics would lose its digits, and say which entry it is."""
    for label, number in zip(labels, value, strict=True):
        if abs(number) > largest:
            expected = f"at most {largest:g} {label.unit} either way".replace("  ", " ")
            raise InvalidValue(f"{key}: {label.name}", float(number), expected)
