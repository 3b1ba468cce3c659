"""Generated C cut into pieces, so that a compiler's time grows with the length of a function and no faster.

CasADi writes a function as one block of statements, tens of thousands of them, and asks of each element that
goes in or out whether its array is there. Compilers take more than linear time for such blocks: to allocate
registers, and to tell which loads and stores may meet. Here a function becomes a row of short ones that keep
what later ones need in an array; arrays that are not there are replaced once, at the entry. Statements and
their order stay as they were, so results differ at most where a multiplication and an addition that stood on
both sides of a cut are no longer fused.

A function with any line that is not known is left as it is.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

__all__ = ["split_functions"]

_PIECE = 500  # statements; of a few hundred the calls and what is kept cost nothing that can be measured
_ZEROS, _SCRATCH = "mbocp_zeros", "mbocp_scratch"

_ARGUMENTS = "const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem"
_HEAD = re.compile(rf"static int (\w+)\({re.escape(_ARGUMENTS)}\) {{")
_END = "}"
_DECLARATION = re.compile(r"  casadi_real (a\d+(?:, a\d+)*);")
_LOAD = re.compile(r"  (a\d+)=arg\[(\d+)\]\? arg\[\2\]\[(\d+)\] : 0;")
_STORE = re.compile(r"  if \(res\[(\d+)\]!=0\) res\[\1\]\[(\d+)\]=(a\d+);")
_ASSIGNMENT = re.compile(r"  (a\d+)=([\w\s.,?:()+\-*/<>=!&|]+);")
# What an expression without side effects does not hold: assignments, addresses, steps, comments.
_NO_VALUE = re.compile(r"(?<![=<>!])=(?!=)|<<|>>|(?<!&)&(?!&)|\+\+|--|//|/\*")
_NAME = re.compile(r"\b[A-Za-z_]\w*")
_VARIABLE = re.compile(r"a\d+")
_NOT_IN_VALUES = frozenset({"arg", "res", "iw", "w", "mem"})


@dataclass(frozen=True)
class _Statement:
    """A line of a function: what it is to be, the variable that it sets, and those that it reads."""

    text: str
    target: str | None
    reads: tuple[str, ...]


@dataclass(frozen=True)
class _Access:
    """Number of an input or output, and how many elements of it are known to be used."""

    number: int
    size: int


@dataclass(frozen=True)
class _Function:
    """A function of known lines.

    Attributes
    ----------
    name : str
    statements : tuple of _Statement
    inputs, outputs : tuple of _Access
        In the order of their numbers.
    """

    name: str
    statements: tuple[_Statement, ...]
    inputs: tuple[_Access, ...]
    outputs: tuple[_Access, ...]


def split_functions(text: str, piece: int = _PIECE) -> str:
    """Generated C with its functions in pieces.

    Parameters
    ----------
    text : str
        As CasADi's code generator writes it.
    piece : int
        Statements of a piece, at most.

    Returns
    -------
    str
        C of the same functions: the text itself where no function is made of known lines alone.
    """
    lines = text.split("\n")
    written: list[str] = []
    found: list[_Function] = []
    first, i = 0, 0
    while i < len(lines):
        head = _HEAD.fullmatch(lines[i])
        end = _index(lines, _END, i) if head else None
        function = _read(head[1], lines[i + 1 : end]) if head and end else None
        if function is None or end is None:
            written.append(lines[i])
            i += 1
            continue
        first = first if found else len(written)
        found.append(function)
        written += _write(function, lines[i], piece)
        i = end + 1
    return "\n".join([*written[:first], *_replacements(found), *written[first:]]) if found else text


def _index(lines: Sequence[str], wanted: str, start: int) -> int | None:
    return next((i for i in range(start, len(lines)) if lines[i] == wanted), None)


def _replacements(functions: Iterable[_Function]) -> Iterator[str]:
    """What stands for inputs and outputs that are not there.

    What is written there nobody reads, but each thread writes into a buffer of its own: they would disturb
    each other's caches.
    """
    inputs = max((a.size for f in functions for a in f.inputs), default=0)
    outputs = max((a.size for f in functions for a in f.outputs), default=0)
    if inputs:
        yield f"static const casadi_real {_ZEROS}[{inputs}] = {{0}};"
    if outputs:
        yield f"static __thread casadi_real {_SCRATCH}[{outputs}];"


def _read(name: str, body: Sequence[str]) -> _Function | None:
    """Return a function from the lines between its braces; None if one of them is not known."""
    declared: set[str] = set()
    known: set[str] = set()  # variables that have a value
    statements: list[_Statement] = []
    inputs: dict[int, int] = {}
    outputs: dict[int, int] = {}
    if not body or body[-1] != "  return 0;":
        return None
    for line in body[:-1]:
        if not statements and (match := _DECLARATION.fullmatch(line)):
            declared.update(match[1].split(", "))
            continue
        if match := _LOAD.fullmatch(line):
            number, element = int(match[2]), int(match[3])
            inputs[number] = max(inputs.get(number, 0), element + 1)
            statement = _Statement(f"  {match[1]}=x{number}[{element}];", match[1], ())
        elif match := _STORE.fullmatch(line):
            number, element = int(match[1]), int(match[2])
            outputs[number] = max(outputs.get(number, 0), element + 1)
            statement = _Statement(f"  y{number}[{element}]={match[3]};", None, (match[3],))
        elif (match := _ASSIGNMENT.fullmatch(line)) and not _NO_VALUE.search(match[2]):
            names = dict.fromkeys(_NAME.findall(match[2]))
            if not _NOT_IN_VALUES.isdisjoint(names):
                return None
            statement = _Statement(line, match[1], tuple(n for n in names if _VARIABLE.fullmatch(n)))
        else:
            return None
        if not known.issuperset(statement.reads):
            return None
        if statement.target is not None:
            if statement.target not in declared:
                return None
            known.add(statement.target)
        statements.append(statement)
    return _Function(name, tuple(statements), _accesses(inputs), _accesses(outputs))


def _accesses(sizes: dict[int, int]) -> tuple[_Access, ...]:
    return tuple(_Access(number, size) for number, size in sorted(sizes.items()))


def _write(function: _Function, head: str, piece: int) -> Iterator[str]:
    """Lines of the pieces, and of a function with the old head that calls them."""
    pieces = _pieces(function.statements, piece)
    read = [_read_first(p) for p in pieces]
    kept = _kept(pieces, read)
    place = {name: i for i, name in enumerate(sorted(set().union(*read)))}
    locals_: list[tuple[str, str, str]] = []  # type, name, value
    for a in function.inputs:
        value = f"arg[{a.number}]? arg[{a.number}] : {_ZEROS}"
        locals_.append(("const casadi_real*", f"x{a.number}", value))
    for a in function.outputs:
        value = f"res[{a.number}]? res[{a.number}] : {_SCRATCH}"
        locals_.append(("casadi_real*", f"y{a.number}", value))
    parameters = [f"{kind} {name}" for kind, name, _ in locals_]
    passed = [name for _, name, _ in locals_]
    if place:
        parameters.append("casadi_real* __restrict__ t")  # an array of the function's own
        passed.append("t")
    for i, statements in enumerate(pieces):
        yield f"static __attribute__((noinline)) void {_part(function, i)}({', '.join(parameters)}) {{"
        yield from _write_piece(statements, read[i], kept[i], place)
        yield _END
        yield ""
    yield head
    for kind, name, value in locals_:
        yield f"  {kind} {name}={value};"
    if place:
        yield f"  casadi_real t[{len(place)}];"
    for i in range(len(pieces)):
        yield f"  {_part(function, i)}({', '.join(passed)});"
    yield "  return 0;"
    yield _END


def _part(function: _Function, i: int) -> str:
    return f"{function.name}_part{i}"


def _pieces(statements: Sequence[_Statement], most: int) -> list[Sequence[_Statement]]:
    """Cut into pieces of nearly the same length."""
    count = -(-len(statements) // most)
    cuts = [len(statements) * i // count for i in range(count + 1)] if count else [0]
    return [statements[a:b] for a, b in pairwise(cuts)]


def _read_first(statements: Iterable[_Statement]) -> set[str]:
    """Variables whose values come from before."""
    read: set[str] = set()
    own: set[str] = set()
    for statement in statements:
        read.update(name for name in statement.reads if name not in own)
        if statement.target is not None:
            own.add(statement.target)
    return read


def _kept(pieces: Sequence[Sequence[_Statement]], read: Sequence[set[str]]) -> list[set[str]]:
    """Variables of each piece whose last values later pieces read."""
    needed: set[str] = set()
    kept = []
    for statements, before in zip(reversed(pieces), reversed(read), strict=True):
        own = {s.target for s in statements if s.target is not None}
        kept.append(own & needed)
        needed = (needed - own) | before
    return kept[::-1]


def _write_piece(
    statements: Sequence[_Statement], read: set[str], kept: set[str], place: dict[str, int]
) -> Iterator[str]:
    """Body of a piece.

    Values are taken from the array where they are first used and put there as soon as they are final: taken
    all at the beginning, most would be copied from one place of the stack to another, a third of the time.
    """
    own = {s.target for s in statements if s.target is not None}
    if own | read:
        yield f"  casadi_real {', '.join(sorted(own | read))};"
    final = {s.target: i for i, s in enumerate(statements)}
    waiting = set(read)
    for i, statement in enumerate(statements):
        for name in statement.reads:
            if name in waiting:
                waiting.remove(name)
                yield f"  {name}=t[{place[name]}];"
        yield statement.text
        if statement.target in kept and final[statement.target] == i:
            yield f"  t[{place[statement.target]}]={statement.target};"
