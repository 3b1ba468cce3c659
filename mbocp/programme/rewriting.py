"""Statements of functions with others in their places that take less time.

A division of vectors takes as long as a dozen products: divisions by the same number become products with its
reciprocal, to within an ulp. A sine takes as long as a sine and a cosine.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

from mbocp.programme import lanes
from mbocp.programme.generated import CALLS, Function, Statement

_QUOTIENT = re.compile(r"\((a\d+)/(a\d+)\)")
_MANY = 3  # divisions by the same number


def with_reciprocals(function: Function) -> Function:
    """Return the function with many divisions by the same number as products with its reciprocal."""
    divisors = list(_divisors(function.statements))
    times = Counter(divisor for divisor in divisors if divisor is not None)
    names: dict[tuple[str, int], str] = {}
    statements: list[Statement] = []
    for s, divisor in zip(function.statements, divisors, strict=True):
        if divisor is None or times[divisor] < _MANY:
            statements.append(s)
            continue
        if divisor not in names:
            names[divisor] = f"{divisor[0]}0{divisor[1]:09d}"  # longer than those that CasADi writes
            reciprocal = f"(1./{divisor[0]})"
            statements.append(Statement(names[divisor], reciprocal, names[divisor], divisor[:1]))
        numerator, name = s.value[1:].split("/")[0], names[divisor]
        statements.append(s._replace(value=f"({numerator}*{name})", reads=(numerator, name)))
    return replace(function, statements=tuple(statements))


def _divisors(statements: tuple[Statement, ...]) -> Iterator[tuple[str, int] | None]:
    """What each statement divides by: the variable, and how often it has got a value before."""
    values: Counter[str] = Counter()
    for s in statements:
        match = _QUOTIENT.fullmatch(s.value) if s.target is not None else None
        yield None if match is None else (match[2], values[match[2]])
        if s.target is not None:
            values[s.target] += 1


def with_sines(function: Function) -> Function:
    """Return a function in lanes with sine and cosine of an angle by one call.

    The second of them is given by that call, in the array of what calls give.
    """
    statements, num_passed = list(function.statements), function.num_passed
    waiting: dict[str, int] = {}  # sines and cosines of variables as they are, and where these stand
    for i, s in enumerate(statements):
        other = lanes.other_half(s.value)
        if other is not None and other in waiting:
            first = waiting.pop(other)
            both = lanes.sine_and_cosine(statements[first].value, f"{CALLS}+{num_passed}")
            statements[first] = statements[first]._replace(value=str(both))
            statements[i] = s._replace(value=f"{CALLS}[{num_passed}]", reads=())
            num_passed += 1
        elif other is not None and s.target not in s.reads:
            waiting[s.value] = i
        if s.target is not None:
            for half in (f"mbocp_sin({s.target})", f"mbocp_cos({s.target})"):
                waiting.pop(half, None)
    return replace(function, statements=tuple(statements), num_passed=num_passed)
