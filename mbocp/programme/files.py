"""C in several files that compile side by side: pieces of functions stand in files of their own.

A compiler works on one core. The pieces that `mbocp.programme.splitting` makes are called by name and know
only what they are passed, so that any of them can be translated elsewhere. They are as they were, and so is
what they compute.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from mbocp.programme.generated import END

_PIECE = re.compile(r"static __attribute__\(\(noinline\)\) (void \w+\([^()]*\)) \{")
_SHARED = '__attribute__((noinline, visibility("hidden")))'
# Of a function for other files; CasADi writes some signatures on two lines.
_DEFINITION = re.compile(r"^(?!static\b|typedef\b|[#/\s}])(?=[^;{}#/]*\) ?\{)", re.M)
_LEAST = 8_000  # lines of a file, below which a second one is not worth its begin


@dataclass(frozen=True)
class _Piece:
    """A function: its declaration, and its first line and the one after its last."""

    declaration: str
    first: int
    end: int

    @property
    def length(self) -> int:
        """Number of lines."""
        return self.end - self.first


def spread(text: str, most: int) -> list[str]:
    """C of a library as files that are linked together, at most so many.

    Parameters
    ----------
    text : str
        As `split_functions` writes it.
    most : int

    Returns
    -------
    list of str
        The text itself where it is short, or has no pieces.
    """
    lines = text.split("\n")
    count = min(most, len(lines) // _LEAST)
    pieces = list(_pieces(lines)) if count > 1 else []
    if not pieces:
        return [text]
    files = _shared_out(pieces, len(lines), count)
    head = _DEFINITION.sub("static ", "\n".join(lines[: pieces[0].first]))
    others = [[head, *(_elsewhere(lines, piece) for piece in file)] for file in files if file]
    return [_without(lines, [piece for file in files for piece in file]), *map("\n".join, others)]


def _pieces(lines: Sequence[str]) -> list[_Piece]:
    found, i = [], 0
    while i < len(lines):
        match = _PIECE.fullmatch(lines[i])
        if match is not None:
            end = lines.index(END, i) + 1
            found.append(_Piece(match[1], i, end))
            i = end
        else:
            i += 1
    return found


def _shared_out(pieces: Sequence[_Piece], total: int, count: int) -> list[list[_Piece]]:
    """Pieces for all files but the first, which keeps what is left: all of about the same length."""
    files: list[list[_Piece]] = [[] for _ in range(count - 1)]
    waiting = list(pieces)
    for file in files:
        length = 0
        while waiting and length + waiting[-1].length / 2 < total / count:
            piece = waiting.pop()
            file.append(piece)
            length += piece.length
    return files


def _elsewhere(lines: Sequence[str], piece: _Piece) -> str:
    body = lines[piece.first + 1 : piece.end]
    return "\n".join([f"{_SHARED} {piece.declaration} {{", *body])


def _without(lines: Sequence[str], pieces: Sequence[_Piece]) -> str:
    """The text with declarations in the place of pieces."""
    kept, i = [], 0
    for piece in sorted(pieces, key=lambda piece: piece.first):
        kept += [*lines[i : piece.first], f"{_SHARED} {piece.declaration};"]
        i = piece.end
    return "\n".join([*kept, *lines[i:]])
