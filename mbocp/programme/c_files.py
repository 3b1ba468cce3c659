"""Functions in C, in files that compile side by side: a compiler works on one core.

The kernel writes a function as a row of short ones that know only what they are passed, so that each of them
can stand in any file; see `mbocp/_native/kernel/c_source.hpp`. What is no operation on numbers, such as a
table that is interpolated, CasADi writes itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path

import casadi as ca

from mbocp._arrays import dataclass
from mbocp.programme.native_modules import kernel
from mbocp.programme.tapes import as_operations

HEADERS = tuple(Path(__file__).with_name(name) for name in ("lanes.h", "functions.h"))
_HIDDEN = '__attribute__((noinline, visibility("hidden"))) '
_LEAST = 8_000  # lines of a file, below which a second one is not worth its begin


@dataclass(frozen=True)
class CText:
    """Functions in C.

    Attributes
    ----------
    parts : tuple of str
        Functions that call each other, and may stand in different files.
    entries : tuple of str
        What is called from outside.
    others : tuple of str
        What CasADi has written, a file by itself; empty where it has written nothing.
    """

    parts: tuple[str, ...]
    entries: tuple[str, ...]
    others: tuple[str, ...]

    @classmethod
    def of(cls, functions: Iterable[ca.Function]) -> CText:
        """Write functions in C."""
        parts: list[str] = []
        entries: list[str] = []
        others: list[ca.Function] = []
        for function in functions:
            found = kernel().write_c(as_operations(function))
            if found is None:
                others.append(function)
            else:
                parts += found[0]
                entries.append(found[1])
        return cls(tuple(parts), tuple(entries), _by_casadi(others))

    @property
    def texts(self) -> tuple[str, ...]:
        """All that a library is made of, however many files there are."""
        return (_header_text(), *self.parts, *self.entries, *self.others)

    def files(self, lanes: int, most: int) -> list[str]:
        """Files that are linked together: at most so many, and what CasADi writes; for so many lanes."""
        return [*(self._share_out(lanes, most) if self.parts else ()), *self.others]

    def _share_out(self, lanes: int, most: int) -> Iterator[str]:
        """Files of about the same length."""
        head = f"#define MBOCP_LANES {lanes}\n{_header_text()}"
        declarations = "".join(f"{_HIDDEN}{part.partition(' {')[0]};\n" for part in self.parts)
        lengths = [part.count("\n") for part in self.parts]
        count = max(1, min(most, sum(lengths) // _LEAST))
        share, length, file = sum(lengths) / count, 0, 0
        shares: list[list[str]] = [[] for _ in range(count)]
        for part, own in zip(self.parts, lengths, strict=True):
            if length > share * (file + 1) and file + 1 < count:
                file += 1
            shares[file].append(part)
            length += own
        for i, written in enumerate(shares):
            yield "".join((head, declarations, *written, *(self.entries if i == 0 else ())))


@cache
def _header_text() -> str:
    return "#include <math.h>\n" + "".join(path.read_text(encoding="ascii") for path in HEADERS)


def _by_casadi(functions: Sequence[ca.Function]) -> tuple[str, ...]:
    if not functions:
        return ()
    generator = ca.CodeGenerator("stage.c")
    for function in functions:
        generator.add(function)
    return (str(generator.dump()),)
