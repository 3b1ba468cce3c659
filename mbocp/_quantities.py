"""Numbers of files: finite floats, and numbers with units, such as "90 deg" and "350 mm", in SI."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple, TypeGuard

from mbocp._text import show

_NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_BEGIN = "[A-Za-zµμ°/(]|1/"  # of a unit
_QUANTITY = re.compile(rf"({_NUMBER})\s*((?:{_BEGIN}).*)")
_TOKEN = re.compile(r"\s*([A-Za-zµμ]+|°|\*\*|[-+]?[0-9.]+|[()/*·^²³])")
PATTERN = rf"^\s*{_NUMBER}\s*({_BEGIN})"  # of texts, for JSON schemas

_LONGEST = 80  # characters of a text with a unit, as much as its parser may nest


class Unit(NamedTuple):
    """A unit: SI is the number times `times` by `over`, which keeps 350 mm at 0.35 m to the last digit.

    Attributes
    ----------
    times, over : float
    powers : tuple of float
        Of m, kg, s and rad.
    """

    times: float
    over: float
    powers: tuple[float, ...]

    def to(self, power: float) -> Unit:
        """Return a power of the unit; a negative one of what it divides."""
        times, over = (self.times, self.over) if power >= 0 else (self.over, self.times)
        return Unit(times ** abs(power), over ** abs(power), tuple(power * one for one in self.powers))

    def by(self, other: Unit) -> Unit:
        """Return the product."""
        powers = tuple(a + b for a, b in zip(self.powers, other.powers, strict=True))
        return Unit(self.times * other.times, self.over * other.over, powers)


_ONE = Unit(1.0, 1.0, (0.0, 0.0, 0.0, 0.0))
_SI = {
    "m": Unit(1.0, 1.0, (1.0, 0.0, 0.0, 0.0)),
    "g": Unit(1.0, 1e3, (0.0, 1.0, 0.0, 0.0)),
    "s": Unit(1.0, 1.0, (0.0, 0.0, 1.0, 0.0)),
    "rad": Unit(1.0, 1.0, (0.0, 0.0, 0.0, 1.0)),
    "N": Unit(1.0, 1.0, (1.0, 1.0, -2.0, 0.0)),
    "Nm": Unit(1.0, 1.0, (2.0, 1.0, -2.0, 0.0)),
    "J": Unit(1.0, 1.0, (2.0, 1.0, -2.0, 0.0)),
    "W": Unit(1.0, 1.0, (2.0, 1.0, -3.0, 0.0)),
}
_PREFIXES = {"": (1.0, 1.0), "k": (1e3, 1.0), "c": (1.0, 1e2), "m": (1.0, 1e3), "u": (1.0, 1e6)}
_OTHERS = {
    "deg": Unit(math.pi, 180.0, _SI["rad"].powers),
    "°": Unit(math.pi, 180.0, _SI["rad"].powers),
    "turn": Unit(2.0 * math.pi, 1.0, _SI["rad"].powers),
    "rpm": Unit(math.pi, 30.0, (0.0, 0.0, -1.0, 1.0)),
    "min": Unit(60.0, 1.0, _SI["s"].powers),
    "in": Unit(254.0, 1e4, _SI["m"].powers),
    "lb": Unit(45359237.0, 1e8, _SI["g"].powers),
}
KNOWN = "m, mm, cm, in, rad, deg, turn, kg, g, lb, s, ms, min, N, J, W, rpm, and their products"
EXAMPLES = '"90 deg", "350 mm" or "1.5 N m"'
_DIMENSIONS = {
    "m": "a length",
    "rad": "an angle",
    "kg": "a mass",
    "s": "a time",
    "m/s": "a speed",
    "rad/s": "an angular speed",
    "N": "a force",
    "N m": "a torque or an energy",
    "W": "a power",
}


@lru_cache(maxsize=256)
def unit_of(text: str) -> Unit | None:
    """Return the unit that a text names; None if it names none."""
    tokens, end = [], 0
    while end < len(text) and (found := _TOKEN.match(text, end)):
        tokens.append(found[1])
        end = found.end()
    if not tokens or text[end:].strip():
        return None
    tokens.reverse()  # the next one is the last
    try:
        unit = _product(tokens)
    except (IndexError, KeyError, ValueError, OverflowError):
        return None
    return None if tokens else unit


def _product(tokens: list[str]) -> Unit:
    unit = _ONE if tokens and tokens[-1] == "/" else _factor(tokens)
    while tokens and tokens[-1] != ")":
        is_below = tokens[-1] == "/"
        if tokens[-1] in "/*·":
            tokens.pop()
        factor = _factor(tokens)
        unit = unit.by(factor.to(-1.0) if is_below else factor)
    return unit


def _factor(tokens: list[str]) -> Unit:
    word, power = tokens.pop(), 1.0
    if word == "sqrt":
        word, power = tokens.pop(), 0.5
    if word == "(":
        unit = _product(tokens)
        if tokens.pop() != ")":
            raise ValueError
    else:
        unit = _ONE if word == "1" else _unit_by_name(word)
    if tokens and tokens[-1] in ("^", "**"):
        tokens.pop()
        power *= float(tokens.pop())
    elif tokens and tokens[-1] in "²³":
        power *= "²³".index(tokens.pop()) + 2.0
    return unit.to(power)


def _unit_by_name(word: str) -> Unit:
    if word in _OTHERS:
        return _OTHERS[word]
    word = re.sub("^[µμ]", "u", word)
    if word in _SI:
        return _SI[word]
    times, over = _PREFIXES[word[:1]]
    return _SI[word[1:]].by(_ONE._replace(times=times, over=over))


def has_unit(text: str) -> bool:
    """Whether a text is a number with something behind it, which may be a unit."""
    return _split(text) is not None


def _split(text: str) -> re.Match[str] | None:
    text = text.strip()
    return _QUANTITY.fullmatch(text) if len(text) <= _LONGEST else None


class Quantity(float):
    """A number [SI] that keeps how it was written, for those who know which of several units is meant."""

    text: str
    powers: tuple[float, ...]
    units: tuple[str, ...]  # that its key is declared with

    @classmethod
    def of(cls, text: str, units: tuple[str, ...]) -> Quantity | None:
        """Return what a text says; None if it is no number with a known unit."""
        found = _split(text)
        unit = unit_of(found[2]) if found else None
        if found is None or unit is None:
            return None
        quantity = cls(float(found[1]) * unit.times / unit.over)
        quantity.text, quantity.powers, quantity.units = text, unit.powers, units
        return quantity

    def like(self, value: float) -> Quantity:
        """Return another number [SI] of the same unit."""
        quantity = type(self)(value)
        quantity.text, quantity.powers, quantity.units = f"{value:g}, as {self.text}", self.powers, self.units
        return quantity

    def describe(self, where: str = "") -> str:
        """Return the text, where it stands and what it measures, for messages."""
        what = next((words for unit, words in _DIMENSIONS.items() if powers_of(unit) == self.powers), "")
        return f"{show(self.text)}{where}{what and ', '}{what}"

    def fits(self, units: tuple[str, ...]) -> bool:
        """Whether it can be said in one of some units."""
        return any(powers_of(one) == self.powers for one in units)


def powers_of(unit: str) -> tuple[float, ...]:
    """Return the powers of a declared unit; none where it is no unit."""
    found = unit_of(unit) if unit else _ONE
    return found.powers if found is not None else ()


LARGEST = 1e100  # of numbers in files: squares and cubes of them are floats, too


def is_number(value: Any) -> TypeGuard[int | float]:
    """Whether `value` is an int or a float; booleans are not."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def as_float(value: int | float) -> float:
    """Return the nearest float, or a quantity as it is; infinite for an integer beyond all of them."""
    if isinstance(value, Quantity):
        return value
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def finite_number(value: Any, where: str = "") -> float:
    """Return `value` as a float of at most `LARGEST`, either sign.

    Raises
    ------
    ValueError
        Saying what was got, and `where`, for pydantic to collect.
    """
    if not is_number(value):
        raise ValueError(f"got {show(value)}{where}, expected a number")
    number = as_float(value)
    if not math.isfinite(number):
        raise ValueError(f"got {show(value)}{where}, expected a finite number")
    if abs(number) > LARGEST:
        raise ValueError(f"got {show(value)}{where}, expected a number of at most {LARGEST:g}")
    return number


def vector(value: Any, where: str = "") -> list[float]:
    """Finite numbers of a list."""
    return [finite_number(entry, f" at index {i}{where}") for i, entry in enumerate(value)]


def check_named_numbers(value: Mapping[str, Any]) -> dict[str, float | list[float]]:
    """Finite numbers, or lists of them, by name."""
    return {
        name: vector(entry, f" for {show(name)}")
        if isinstance(entry, list)
        else finite_number(entry, f" for {show(name)}")
        for name, entry in value.items()
    }
