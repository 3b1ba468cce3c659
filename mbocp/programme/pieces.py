"""Statements of a function in a row of short functions.

Compilers take more than linear time for long blocks of statements. What later pieces need of earlier ones is
kept in an array, unless it is an input, or what a call gave: that is taken again from where it came. A call
of another function is a piece of its own, which stands where the pieces are called.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

from mbocp.programme.generated import CALLS, END, Call, Function, Statement


@dataclass(frozen=True)
class Pieces:
    """A function in pieces.

    Attributes
    ----------
    function : Function
    pieces : list of sequence of Statement
    read : list of dict
        Variables of each piece whose values come from before, and where these are to be had.
    kept : list of set of str
        Variables of each piece whose last values later pieces take from the array.
    place : dict
        Where in an array of the function's own a variable is between pieces.
    """

    function: Function
    pieces: list[Sequence[Statement]]
    read: list[dict[str, str]]
    kept: list[set[str]]
    place: dict[str, int]

    @classmethod
    def of(cls, function: Function, most: int) -> Pieces:
        """Of so many statements at most."""
        pieces = _pieces(function.statements, most)
        sources = list(_sources(pieces))
        kept = [
            {n for n in _read_first(p) if n not in known} for p, known in zip(pieces, sources, strict=True)
        ]
        place = {name: i for i, name in enumerate(sorted(set().union(*kept)))}
        read = [
            {name: known.get(name) or f"t[{place[name]}]" for name in _read_first(p)}
            for p, known in zip(pieces, sources, strict=True)
        ]
        return cls(function, pieces, read, _variables_read_later(pieces, kept), place)

    def parameters(self, kind: str) -> list[str]:
        """Inputs and outputs of a function that calls the pieces."""
        inputs = [f"const {kind}* x{a.number}" for a in self.function.inputs]
        return inputs + [f"{kind}* y{a.number}" for a in self.function.outputs]

    def write(self, kind: str) -> Iterator[str]:
        """Lines of the pieces, with numbers of that type."""
        parameters = self.parameters(kind) + [f"{kind}* __restrict__ {array}" for array in self._arrays]
        for i, statements in enumerate(self.pieces):
            if statements[0].call is not None:
                continue
            name = _part(self.function, i)
            yield f"static __attribute__((noinline)) void {name}({', '.join(parameters)}) {{"
            yield from _write_piece(statements, self.read[i], self.kept[i], self.place, kind)
            yield END
            yield ""

    def call(self, kind: str, calling: Callable[[Call], str]) -> Iterator[str]:
        """Lines that call the pieces, where the inputs and outputs have the names of the parameters.

        `calling` gives the line of a call of another function.
        """
        passed = [f"x{a.number}" for a in self.function.inputs]
        passed += [f"y{a.number}" for a in self.function.outputs]
        for array, size in self._arrays.items():
            yield f"  {kind} {array}[{size}];"
            passed.append(array)
        for i, statements in enumerate(self.pieces):
            call = statements[0].call
            yield f"  {_part(self.function, i)}({', '.join(passed)});" if call is None else calling(call)

    @property
    def _arrays(self) -> dict[str, int]:
        """Arrays of the function's own, and their sizes."""
        sizes = {"t": len(self.place), CALLS: self.function.num_passed}
        return {array: size for array, size in sizes.items() if size}

    @property
    def num_kept(self) -> int:
        """Numbers in these arrays."""
        return sum(self._arrays.values())


def _part(function: Function, i: int) -> str:
    return f"{function.name}_part{i}"


def _pieces(statements: Sequence[Statement], most: int) -> list[Sequence[Statement]]:
    """Cut at calls, and between them into pieces of nearly the same length."""
    pieces: list[Sequence[Statement]] = []
    for is_call, run in groupby(statements, lambda s: s.call is not None):
        between = list(run)
        count = len(between) if is_call else -(-len(between) // most)
        cuts = [len(between) * i // count for i in range(count + 1)]
        pieces += [between[a:b] for a, b in pairwise(cuts)]
    return pieces


def _read_first(statements: Iterable[Statement]) -> set[str]:
    """Variables whose values come from before."""
    read: set[str] = set()
    own: set[str] = set()
    for statement in statements:
        for name in statement.reads:
            if name not in own:
                read.add(name)
        if statement.target is not None:
            own.add(statement.target)
    return read


def _sources(pieces: Sequence[Sequence[Statement]]) -> Iterator[dict[str, str]]:
    """Where the values of variables come from that are inputs or given by calls, before each piece."""
    known: dict[str, str] = {}
    for statements in pieces:
        yield dict(known)
        for s in statements:
            if s.target is None:
                continue
            if s.reads or not s.value.startswith(("x", f"{CALLS}[")):
                known.pop(s.target, None)
            else:
                known[s.target] = s.value


def _variables_read_later(pieces: Sequence[Sequence[Statement]], read: Sequence[set[str]]) -> list[set[str]]:
    """Variables of each piece whose last values later pieces read."""
    needed: set[str] = set()
    kept = []
    for statements, before in zip(reversed(pieces), reversed(read), strict=True):
        own = {s.target for s in statements if s.target is not None}
        kept.append(own & needed)
        needed = (needed - own) | before
    return kept[::-1]


def _write_piece(
    statements: Sequence[Statement], read: dict[str, str], kept: set[str], place: dict[str, int], kind: str
) -> Iterator[str]:
    """Body of a piece.

    Values are taken from the array where they are first used and put there as soon as they are final: taken
    all at the beginning, most would be copied from one place of the stack to another, a third of the time.
    """
    own = {s.target for s in statements if s.target is not None}
    if own.union(read):
        yield f"  {kind} {', '.join(sorted(own.union(read)))};"
    final = {s.target: i for i, s in enumerate(statements)}
    waiting = set(read)
    for i, statement in enumerate(statements):
        for name in statement.reads:
            if name in waiting:
                waiting.remove(name)
                yield f"  {name}={read[name]};"
        yield statement.text
        if statement.target in kept and final[statement.target] == i:
            yield f"  t[{place[statement.target]}]={statement.target};"
