"""Functions that CasADi's code generator writes, as statements of known form.

A function is one block of lines: variables, loads of inputs, values, stores of outputs, and calls of other
such functions. What a call takes and gives is in a part of an array of the function's own.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

CALLS = "c"  # the array of what calls take and give

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
_PASSED = "(arg, res, iw, w, mem);"
_EXPORT = re.compile(
    rf"^CASADI_SYMBOL_EXPORT int (\w+)\({re.escape(_ARGUMENTS)}\) ?{{\s+return (\w+){re.escape(_PASSED)}",
    re.M,
)
# Of a call: parts of an input or of the array `w`, what is put there, the call itself, what is taken.
_PASS_INPUT = re.compile(r"  arg\[(\d+)\] = arg\[(\d+)\]\? arg\[\2\] \+ (\d+) : 0;")
_PASS_WORK = re.compile(r"  (arg|res)\[(\d+)\]=w\+(\d+);")
_PUT = re.compile(r"  w\[(\d+)\] = (a\d+);")
_CALL = re.compile(r"  if \((\w+)\(arg\+(\d+), res\+(\d+), iw, w\+(\d+), 0\)\) return 1;")
_TAKE = re.compile(r"  (a\d+) = w\[(\d+)\];")


class Call(NamedTuple):
    """A call of another function, with an array for each input and output that it uses."""

    function: str
    inputs: tuple[tuple[int, str], ...]
    outputs: tuple[tuple[int, str], ...]


class Statement(NamedTuple):
    """A line of a function: where it puts a value, the value, the variable it sets, those that it reads.

    One that is a call has none of them.
    """

    place: str
    value: str
    target: str | None
    reads: tuple[str, ...]
    call: Call | None = None

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
    num_passed : int
        Numbers that calls take and give.
    """

    name: str
    statements: tuple[Statement, ...]
    inputs: tuple[Access, ...]
    outputs: tuple[Access, ...]
    num_passed: int = 0

    @property
    def calls(self) -> frozenset[str]:
        """Names of the functions that it calls."""
        return frozenset(s.call.function for s in self.statements if s.call is not None)


def exported_names(text: str) -> dict[str, str]:
    """By the name of a function in the text, the name under which the library offers it."""
    return {static: name for name, static in _EXPORT.findall(text)}


def read_function(name: str, body: Sequence[str], known: Mapping[str, Function]) -> Function | None:
    """Return a function from the lines between its braces; None if one of them is not known.

    `known` are the functions that it may call.
    """
    if not body or body[-1] != "  return 0;":
        return None
    reader = _Reader(known)
    if not all(reader.read(line) for line in body[:-1]) or reader.is_calling:
        return None
    inputs, outputs = _accesses(reader.inputs), _accesses(reader.outputs)
    return Function(name, tuple(reader.statements), inputs, outputs, reader.num_passed)


@dataclass
class _Reader:
    """What is known of a function after some of its lines."""

    functions: Mapping[str, Function]
    statements: list[Statement] = field(default_factory=list)
    inputs: dict[int, int] = field(default_factory=dict)
    outputs: dict[int, int] = field(default_factory=dict)
    num_passed: int = 0
    _declared: set[str] = field(default_factory=set)
    _known: set[str] = field(default_factory=set)  # variables that have a value
    _passed: dict[tuple[str, int], str] = field(default_factory=dict)  # arrays of the next call
    _room: int = 0  # numbers of the array `w` that the next call, or the last one, uses
    _given: dict[str, str] = field(default_factory=dict)  # variables that a call gave, and nothing has used

    @property
    def is_calling(self) -> bool:
        """Whether a call has begun."""
        return bool(self._passed)

    def read(self, line: str) -> bool:
        """Add a line; whether its form is known."""
        if not self.statements and (match := _DECLARATION.fullmatch(line)):
            self._declared.update(match[1].split(", "))
            return True
        if "arg[" in line and (match := _LOAD.fullmatch(line)):
            number, element = int(match[2]), int(match[3])
            self._use(self.inputs, number, element + 1)
            return self._add(Statement(match[1], f"x{number}[{element}]", match[1], ()))
        if line.startswith("  if (") and (match := _STORE.fullmatch(line)):
            number, element = int(match[1]), int(match[2])
            self._use(self.outputs, number, element + 1)
            return self._add(Statement(f"y{number}[{element}]", match[3], None, (match[3],)))
        if (match := _ASSIGNMENT.fullmatch(line)) and not _NO_VALUE.search(match[2]):
            reads = tuple(dict.fromkeys(_VARIABLES.findall(match[2])))
            return self._add(Statement(match[1], match[2], match[1], reads))
        return self._read_call(line)

    def _read_call(self, line: str) -> bool:
        """Add a line of a call. What it gives is read where it is first used, as it stays where it is."""
        if match := _PASS_INPUT.fullmatch(line):
            self._passed["arg", int(match[1])] = f"x{match[2]}+{match[3]}"
        elif match := _PASS_WORK.fullmatch(line):
            self._passed[match[1], int(match[2])] = f"{CALLS}+{self.num_passed + int(match[3])}"
        elif (match := _PUT.fullmatch(line)) and self.is_calling:
            return self._add(Statement(self._in_array(match[1]), match[2], None, (match[2],)))
        elif match := _CALL.fullmatch(line):
            return self._add_call(match[1], *map(int, match.groups()[1:]))
        elif (match := _TAKE.fullmatch(line)) and not self.is_calling and int(match[2]) < self._room:
            self._known.add(match[1])
            self._given[match[1]] = f"{CALLS}[{self.num_passed - self._room + int(match[2])}]"
            return match[1] in self._declared
        else:
            return False
        return True

    def _in_array(self, element: str) -> str:
        return f"{CALLS}[{self.num_passed + int(element)}]"

    def _add_call(self, name: str, first_input: int, first_output: int, room: int) -> bool:
        function = self.functions.get(name)
        if function is None:
            return False
        inputs = self._arrays("arg", first_input, function.inputs)
        outputs = self._arrays("res", first_output, function.outputs)
        if inputs is None or outputs is None:
            return False
        for a, (_, array) in zip(function.inputs, inputs, strict=True):
            if array.startswith("x"):
                number, start = array[1:].split("+")
                self._use(self.inputs, int(number), int(start) + a.size)
        self.statements.append(Statement("", "", None, (), Call(name, inputs, outputs)))
        self._passed.clear()
        self.num_passed += room
        self._room = room
        return True

    def _arrays(
        self, what: str, first: int, accesses: Sequence[Access]
    ) -> tuple[tuple[int, str], ...] | None:
        """Arrays that a call is passed; None where one of them is not known."""
        places = [(a.number, self._passed.get((what, first + a.number))) for a in accesses]
        known = tuple((number, place) for number, place in places if place is not None)
        return known if len(known) == len(places) else None

    def _use(self, accesses: dict[int, int], number: int, size: int) -> None:
        accesses[number] = max(accesses.get(number, 0), size)

    def _add(self, statement: Statement) -> bool:
        if not self._known.issuperset(statement.reads):
            return False
        for name in statement.reads:
            if (place := self._given.pop(name, None)) is not None:
                self.statements.append(Statement(name, place, name, ()))
        if statement.target is not None:
            if statement.target not in self._declared:
                return False
            self._known.add(statement.target)
            self._given.pop(statement.target, None)
        self.statements.append(statement)
        return True


def _accesses(sizes: dict[int, int]) -> tuple[Access, ...]:
    return tuple(Access(number, size) for number, size in sorted(sizes.items()))
