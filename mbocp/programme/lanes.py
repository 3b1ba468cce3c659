"""Generated C for several stages at once: a number becomes one number for each lane of a vector register.

Stages are evaluated at different points by the same statements. With vectors in the place of numbers every
statement serves four stages (AVX2) or eight (AVX-512), and there are no more of them to compile. Arithmetic
stays as it is written. Comparisons and choices, which C knows otherwise for vectors, and functions of the
library go by names of `lanes.h`; what has none there is called lane by lane.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

KIND = "mbocp_lanes"  # the type of a number in each lane
_HEADER = Path(__file__).with_name("lanes.h")
SOURCES = (_HEADER,)  # of the C, beside this module
_MOST = 4 << 20  # bytes of such numbers at a time: they are on the stack

_VARIABLE = r"(a\d+)"
_VARIABLES = re.compile(r"\ba\d+\b")
_ARITHMETIC = re.compile(r"\(?-?(?:[12]\.[*/])?a\d+(?:[+\-*/]a\d+)?\)?")
_SQUARE = re.compile(rf"casadi_sq\({_VARIABLE}\)")
_CHOICE = re.compile(rf"\({_VARIABLE}\?{_VARIABLE}:0\)")
_NEGATION = re.compile(rf"\(!{_VARIABLE}\)")
_COMPARISON = re.compile(rf"\({_VARIABLE}(<|<=|==|!=|&&|\|\|){_VARIABLE}\)")
_CALL = re.compile(rf"(\w+)\({_VARIABLE}(?:,{_VARIABLE})?\)")
_COMPARED = {"<": "less", "<=": "at_most", "==": "equal", "!=": "unequal", "&&": "and", "||": "or"}
_SINE = re.compile(rf"mbocp_(sin|cos)\({_VARIABLE}\)")
_OTHER = {"sin": "cos", "cos": "sin"}
_KNOWN = frozenset({"fabs", "fmin", "fmax", "sign", "sqrt", "sin", "cos"})


@dataclass(frozen=True)
class Lanes:
    """How many stages go at once, and in which functions.

    Attributes
    ----------
    number : int
        Lanes of a vector register.
    functions : frozenset of str
        Names of the functions.
    """

    number: int
    functions: frozenset[str]

    def __str__(self) -> str:
        return f"{self.number} lanes: {' '.join(sorted(self.functions))}"

    def fit(self, numbers: int) -> bool:
        """Whether so many numbers of each stage may be on the stack."""
        return 8 * self.number * numbers <= _MOST


@cache
def _header_text() -> str:
    return _HEADER.read_text(encoding="ascii")


def header(lanes: Lanes, called: Iterable[tuple[str, int]]) -> Iterator[str]:
    """Lines before the first function: `lanes.h`, and functions of the library that go lane by lane.

    Parameters
    ----------
    lanes : Lanes
    called : iterable of (str, int)
        Names of these functions, and how many arguments they have, as `one_by_one` gives them.
    """
    yield f"#define MBOCP_LANES {lanes.number}"
    yield from _header_text().splitlines()
    for name, arguments in sorted(set(called)):
        yield f"{'MBOCP_EACH' if arguments == 1 else 'MBOCP_EACH_OF_TWO'}({name})"


def in_lanes(value: str) -> str | None:
    """An expression of CasADi's C with a number in each lane; None where it has no known form."""
    if _ARITHMETIC.fullmatch(value):
        return value
    if not _VARIABLES.search(value):
        return f"mbocp_all({value})"
    if match := _SQUARE.fullmatch(value):
        return f"({match[1]}*{match[1]})"
    if match := _CHOICE.fullmatch(value):
        return f"mbocp_if({match[1]},{match[2]})"
    if match := _NEGATION.fullmatch(value):
        return f"mbocp_not({match[1]})"
    if match := _COMPARISON.fullmatch(value):
        return f"mbocp_{_COMPARED[match[2]]}({match[1]},{match[3]})"
    if match := _CALL.fullmatch(value):
        name = match[1].removeprefix("casadi_")
        function = f"mbocp_{name}" if name in _KNOWN else f"mbocp_each_{match[1]}"
        return f"{function}({match[2]}{',' + match[3] if match[3] else ''})"
    return None


def one_by_one(value: str) -> tuple[str, int] | None:
    """Name of the function that a value of `in_lanes` calls lane by lane, and how many arguments it has."""
    match = re.match(r"mbocp_each_(\w+)\(", value)
    return None if match is None else (match[1], value.count(",") + 1)


def sine_and_cosine(value: str, place: str) -> str | None:
    """A sine or cosine whose other half is put at a place by the same call; None where it is neither."""
    match = _SINE.fullmatch(value)
    return match and f"mbocp_{match[1]}_and_{_OTHER[match[1]]}({match[2]},{place})"


def other_half(value: str) -> str | None:
    """Return the cosine of an angle for its sine, and the other way around; None where it is neither."""
    match = _SINE.fullmatch(value)
    return match and f"mbocp_{_OTHER[match[1]]}({match[2]})"
