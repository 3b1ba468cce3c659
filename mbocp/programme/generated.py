"""Functions that CasADi's code generator writes, as statements of known form.

A function is one block of lines: variables, loads of inputs, values, stores of outputs.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

__all__ = ["END", "HEAD", "Access", "Function", "Statement", "exported_names", "read_function"]

_ARGUMENTS = "const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem"
HEAD = re.compile(rf"static int (\w+)\({re.escape(_ARGUMENTS)}\) {{")
END = "}"
_DECLARATION = re.compile(r"  casadi_real (a\d+(?:, a\d+)*);")
_LOAD = re.compile(r"  (a\d+)=arg\[(\d+)\]\? arg\[\2\]\[(\d+)\] : 0;")
_STORE = re.compile(r"  if \(res\[(\d+)\]!=0\) res\[\1\]\[(\d+)\]=(a\d+);")
_ASSIGNMENT = re.compile(r"  (a\d+)=([\w\s.,?:()+\-*/<>=!&|]+);")
# What an expression without side effects does not hold: assignments, addresses, steps, comments.
# Nor names of the function's own arguments.
_NO_VALUE = re.compile(r"(?<![=<>!])=(?!=)|<<|>>|(?<!&)&(?!&)|\+\+|--|//|/\*|\b(?:arg|res|iw|w|mem)\b")
_VARIABLES = re.compile(r"\ba\d+\b")
_CALL = "(arg, res, iw, w, mem);"
_EXPORT = re.compile(
    rf"^CASADI_SYMBOL_EXPORT int (\w+)\({re.escape(_ARGUMENTS)}\) ?{{\s+return (\w+){re.escape(_CALL)}", re.M
)


class Statement(NamedTuple):
    """A line of a function: where it puts a value, the value, the variable it sets, those that it reads."""

    place: str
    value: str
    target: str | None
    reads: tuple[str, ...]

    @property
    def text(self) -> str:
        """The line."""
        return f"  {self.place}={self.value};"


@dataclass(frozen=True)
class Access:
    """Number of an input or output, and how many elements of it are known to be used."""

    number: int
    size: int


@dataclass(frozen=True)
class Function:
    """A function of known lines.

    Attributes
    ----------
    name : str
    statements : tuple of Statement
    inputs, outputs : tuple of Access
        In the order of their numbers.
    """

    name: str
    statements: tuple[Statement, ...]
    inputs: tuple[Access, ...]
    outputs: tuple[Access, ...]


def exported_names(text: str) -> dict[str, str]:
    """By the name of a function in the text, the name under which the library offers it."""
    return {static: name for name, static in _EXPORT.findall(text)}


def read_function(name: str, body: Sequence[str]) -> Function | None:
    """Return a function from the lines between its braces; None if one of them is not known."""
    declared: set[str] = set()
    known: set[str] = set()  # variables that have a value
    statements: list[Statement] = []
    inputs: dict[int, int] = {}
    outputs: dict[int, int] = {}
    if not body or body[-1] != "  return 0;":
        return None
    for line in body[:-1]:
        if not statements and (match := _DECLARATION.fullmatch(line)):
            declared.update(match[1].split(", "))
            continue
        if "arg[" in line and (match := _LOAD.fullmatch(line)):
            number, element = int(match[2]), int(match[3])
            inputs[number] = max(inputs.get(number, 0), element + 1)
            statement = Statement(match[1], f"x{number}[{element}]", match[1], ())
        elif line.startswith("  if (") and (match := _STORE.fullmatch(line)):
            number, element = int(match[1]), int(match[2])
            outputs[number] = max(outputs.get(number, 0), element + 1)
            statement = Statement(f"y{number}[{element}]", match[3], None, (match[3],))
        elif (match := _ASSIGNMENT.fullmatch(line)) and not _NO_VALUE.search(match[2]):
            reads = tuple(dict.fromkeys(_VARIABLES.findall(match[2])))
            statement = Statement(match[1], match[2], match[1], reads)
        else:
            return None
        if not known.issuperset(statement.reads):
            return None
        if statement.target is not None:
            if statement.target not in declared:
                return None
            known.add(statement.target)
        statements.append(statement)
    return Function(name, tuple(statements), _accesses(inputs), _accesses(outputs))


def _accesses(sizes: dict[int, int]) -> tuple[Access, ...]:
    return tuple(Access(number, size) for number, size in sorted(sizes.items()))
