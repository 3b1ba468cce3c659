"""Statements of a function in a row of short functions.

Compilers take more than linear time for long blocks of statements. What later pieces need of earlier ones is
kept in an array.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from mbocp.programme.generated import END, Function, Statement

__all__ = ["Pieces"]


@dataclass(frozen=True)
class Pieces:
    """A function in pieces.

    Attributes
    ----------
    function : Function
    pieces : list of sequence of Statement
    read : list of set of str
        Variables of each piece whose values come from before.
    place : dict
        Where in an array of the function's own a variable is between pieces.
    """

    function: Function
    pieces: list[Sequence[Statement]]
    read: list[set[str]]
    place: dict[str, int]

    @classmethod
    def of(cls, function: Function, most: int) -> Pieces:
        """Of so many statements at most."""
        pieces = _pieces(function.statements, most)
        read = [_read_first(p) for p in pieces]
        return cls(function, pieces, read, {name: i for i, name in enumerate(sorted(set().union(*read)))})

    def parameters(self, kind: str) -> list[str]:
        """Inputs and outputs of a function that calls the pieces."""
        inputs = [f"const {kind}* x{a.number}" for a in self.function.inputs]
        return inputs + [f"{kind}* y{a.number}" for a in self.function.outputs]

    def write(self, kind: str) -> Iterator[str]:
        """Lines of the pieces, with numbers of that type."""
        parameters = self.parameters(kind) + ([f"{kind}* __restrict__ t"] if self.place else [])
        kept = _kept(self.pieces, self.read)
        for i, statements in enumerate(self.pieces):
            name = _part(self.function, i)
            yield f"static __attribute__((noinline)) void {name}({', '.join(parameters)}) {{"
            yield from _write_piece(statements, self.read[i], kept[i], self.place, kind)
            yield END
            yield ""

    def call(self, kind: str) -> Iterator[str]:
        """Lines that call the pieces, where the inputs and outputs have the names of the parameters."""
        passed = [f"x{a.number}" for a in self.function.inputs] + [
            f"y{a.number}" for a in self.function.outputs
        ]
        if self.place:
            yield f"  {kind} t[{len(self.place)}];"
            passed.append("t")
        for i in range(len(self.pieces)):
            yield f"  {_part(self.function, i)}({', '.join(passed)});"


def _part(function: Function, i: int) -> str:
    return f"{function.name}_part{i}"


def _pieces(statements: Sequence[Statement], most: int) -> list[Sequence[Statement]]:
    """Cut into pieces of nearly the same length."""
    count = -(-len(statements) // most)
    cuts = [len(statements) * i // count for i in range(count + 1)] if count else [0]
    return [statements[a:b] for a, b in pairwise(cuts)]


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


def _kept(pieces: Sequence[Sequence[Statement]], read: Sequence[set[str]]) -> list[set[str]]:
    """Variables of each piece whose last values later pieces read."""
    needed: set[str] = set()
    kept = []
    for statements, before in zip(reversed(pieces), reversed(read), strict=True):
        own = {s.target for s in statements if s.target is not None}
        kept.append(own & needed)
        needed = (needed - own) | before
    return kept[::-1]


def _write_piece(
    statements: Sequence[Statement], read: set[str], kept: set[str], place: dict[str, int], kind: str
) -> Iterator[str]:
    """Body of a piece.

    Values are taken from the array where they are first used and put there as soon as they are final: taken
    all at the beginning, most would be copied from one place of the stack to another, a third of the time.
    """
    own = {s.target for s in statements if s.target is not None}
    if own | read:
        yield f"  {kind} {', '.join(sorted(own | read))};"
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
