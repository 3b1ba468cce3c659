"""Elementary checks of what a user gives: the name, what was got, what was expected."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import partial
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from mbocp._arrays import Array
from mbocp._keys import Check
from mbocp._text import show
from mbocp.exceptions import InvalidValue, UnknownFrame, locate
from mbocp.robot.parts import Label

if TYPE_CHECKING:
    from mbocp.robot.model import RobotModel

MAX_POSITION = 1e9  # [m, rad] as in replays; a float of this size is exact to 1e-7
MAX_RATE = 1e15  # [m/s, rad/s, kg m/s, N m s] as of the numbers of a robot; products of several have numbers
_MAX_INTEGER = 2**31 - 1


class ProblemWarning(UserWarning):
    """Something about a problem that is allowed, but probably not meant."""


def check_frame(key: str, robot: RobotModel, name: str) -> int:
    """Return the index of a frame; an unknown one is refused at the key."""
    with locate(key, UnknownFrame):
        return robot.frame_id(name)


def check_bool(name: str, value: Any) -> bool:
    """Return `value` if it is True or False."""
    if not isinstance(value, bool):
        raise InvalidValue(name, show(value), "true or false")
    return value


def check_number(name: str, value: Any) -> float:
    """Return `value` as a finite float."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InvalidValue(name, show(value), "a number")
    try:
        number = float(value)
    except OverflowError:  # an integer beyond all floats
        raise InvalidValue(name, show(value), "a finite number") from None
    if not math.isfinite(number):
        raise InvalidValue(name, number, "a finite number")
    return number


def check_positive(name: str, value: Any, unit: str = "") -> float:
    """Return `value` as a finite float above zero."""
    number = check_number(name, value)
    if number <= 0.0:
        raise InvalidValue(name, number, f"a positive number{f' [{unit}]' if unit else ''}")
    return number


def check_integer(name: str, value: Any, minimum: int, maximum: int = _MAX_INTEGER) -> int:
    """Return `value` as an int between both, by default of 32 bits, as many as foreign libraries count."""
    expected = f"a whole number of at least {minimum}"
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise InvalidValue(name, show(value), expected)
    if value < minimum:
        raise InvalidValue(name, show(int(value)), expected)
    if value > maximum:
        raise InvalidValue(name, show(int(value)), f"{expected} and at most {maximum}")
    return int(value)


def check_finite(name: str, value: Array) -> None:
    """Refuse NaN and infinite entries, and say where the first one is."""
    if np.count_nonzero(np.isfinite(value)) < value.size:  # in half the time of `all`
        bad = np.argwhere(~np.isfinite(value))[0]
        where = ", ".join(str(i) for i in bad)
        raise InvalidValue(f"{name}[{where}]", float(value[tuple(bad)]), "a finite number")


def check_non_negative(name: str, value: Array | float) -> None:
    """Refuse weights below zero, and say where the first one is."""
    array = np.asarray(value, dtype=np.float64)
    if np.count_nonzero(array < 0.0):
        bad = np.argwhere(array < 0.0)[0]
        where = f"[{', '.join(str(i) for i in bad)}]" if array.ndim else ""
        raise InvalidValue(f"{name}{where}", float(array[tuple(bad)]), "a weight >= 0")


def check_choice(name: str, value: Any, allowed: Iterable[str], note: str = "") -> str:
    """Refuse a word that is not among the `allowed` ones, listing them."""
    words = tuple(allowed)
    if value not in words:
        raise InvalidValue.of_choice(name, value, words, note)
    return str(value)


def check_size(key: str, value: Array, labels: Sequence[Label], largest: float) -> None:
    """Refuse a state so large that the mechanics would lose its digits, and say which entry it is."""
    for label, number in zip(labels, value, strict=True):
        if abs(number) > largest:
            expected = f"at most {largest:g} {label.unit} either way".replace("  ", " ")
            raise InvalidValue(f"{key}: {label.name}", float(number), expected)


def choice(words: Iterable[str]) -> Check:
    """Return the check of a key that takes one of some words."""
    allowed = tuple(words)
    return Check(
        ", ".join(f'`"{w}"`' for w in allowed),
        {"enum": [*allowed]},
        work=partial(check_choice, allowed=allowed),
    )


def whole(minimum: int) -> Check:
    """Return the check of a key that takes a whole number of at least `minimum`."""
    words = f"whole number > {minimum - 1}"
    return Check(words, {"minimum": minimum}, work=partial(check_integer, minimum=minimum))


def positive(unit: str = "") -> Check:
    """Return the check of a key that takes a number above zero."""
    return Check("number > 0", {"exclusiveMinimum": 0}, work=partial(check_positive, unit=unit))
