"""The table that grows while a solver works: live on a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import sys
import time
from collections import deque
from types import TracebackType
from typing import Protocol

from rich.console import Console, Group
from rich.live import Live
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

__all__ = ["Progress", "Record"]

_ROWS = 12  # as many iterations of the phase at work stay in view
_PERIOD = 0.05  # [s] between two pictures: a Newton step may take a millisecond, drawing takes longer
# Without a terminal: of each phase the first so many iterations, then every tenth, then every hundredth.
_PLAIN_ROWS, _PLAIN_TENTHS = 20, 200

_COLUMNS = ("iteration", "cost", "residual", "increment", "step", "time")
_WIDTHS = (9, 15, 9, 9, 8, 8)


class Record(Protocol):
    """What is shown of an iteration; `mbocp.solution.IterationRecord` has it."""

    @property
    def iteration(self) -> int:
        """Number of the iteration."""

    @property
    def cost(self) -> float:
        """Objective."""

    @property
    def residual(self) -> float:
        """Norm of the optimality conditions."""

    @property
    def increment(self) -> float:
        """Norm of the change of the unknowns."""

    @property
    def step_length(self) -> float:
        """Fraction of the Newton step."""

    @property
    def phase(self) -> str:
        """Phase of the solve that it belongs to."""


class _Section:
    """Rows of one phase."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.count, self.iteration = 0, -1
        self.first: tuple[str, ...] = ()
        self.rows: deque[tuple[str, ...]] = deque(maxlen=_ROWS)

    def is_over(self, record: Record) -> bool:
        """Whether a record belongs to the next phase; one of the same name begins with a repeated number."""
        return record.phase != self.name or record.iteration <= self.iteration

    def add(self, record: Record, row: tuple[str, ...]) -> None:
        self.count, self.iteration = self.count + 1, record.iteration
        self.first = self.first or row
        self.rows.append(row)

    def shorten(self) -> None:
        """Keep where the phase began and where it came to."""
        self.rows = deque([self.rows[-1]] if self.count == 1 else [self.first, self.rows[-1]])


class Progress:
    """Callback of a solver that shows its iterations on stderr, phase after phase.

    Parameters
    ----------
    title : str
        What is being solved.
    quiet : bool
        Show nothing.
    console : rich.console.Console, optional
        Where to; default: stderr.
    """

    def __init__(self, title: str, *, quiet: bool = False, console: Console | None = None) -> None:
        self.title, self.quiet = title, quiet
        self._console = console if console is not None else Console(file=sys.stderr)
        self._sections: list[_Section] = []
        self._unprinted: tuple[str, ...] = ()
        self._begin = self._drawn = time.perf_counter()
        self._doing = ""
        self._spinner = Spinner("dots")
        self._live: Live | None = None

    def __enter__(self) -> Progress:
        if not self.quiet and self._console.is_terminal:
            self._live = Live(self._picture(), console=self._console, refresh_per_second=10, transient=True)
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is None:
            self._print_row(self._unprinted)
            return
        self._doing = ""
        self._live.update(self._picture())
        self._live.stop()
        if self._sections and kind is None:
            self._console.print(*self._tables(), sep="\n")  # the last iterations stay

    def say(self, doing: str) -> None:
        """Show what is going on before the first iteration."""
        self._doing = doing
        self._draw(now=True)

    def __call__(self, record: Record) -> None:
        """Show an iteration."""
        is_new = not self._sections or self._sections[-1].is_over(record)
        if is_new:
            for section in self._sections:
                section.shorten()
            self._sections.append(_Section(record.phase))
        self._doing = record.phase
        row = _row(record, time.perf_counter() - self._begin)
        self._sections[-1].add(record, row)
        if self._live is None:
            self._print_plain(row, is_new=is_new)
        else:
            self._draw(now=is_new)

    def _draw(self, *, now: bool) -> None:
        moment = time.perf_counter()
        if self._live is not None and (now or moment - self._drawn > _PERIOD):
            self._drawn = moment
            self._live.update(self._picture(), refresh=True)

    def _print_plain(self, row: tuple[str, ...], *, is_new: bool) -> None:
        section = self._sections[-1]
        if is_new:
            self._print_row(self._unprinted)  # where the phase before came to
            if len(self._sections) == 1:
                self._print_row(_COLUMNS)
            self._print_line(section.name)
        every = 1 if section.count <= _PLAIN_ROWS else 10 if section.count <= _PLAIN_TENTHS else 100
        if section.count % every == 0:
            self._print_row(row)
        self._unprinted = row if section.count % every else ()

    def _print_row(self, row: tuple[str, ...]) -> None:
        self._print_line("  ".join(n.rjust(w) for n, w in zip(row, _WIDTHS, strict=True)) if row else "")

    def _print_line(self, line: str) -> None:
        if line and not self.quiet:
            self._console.file.write(line + "\n")

    def _picture(self) -> Group:
        parts: list[Table | Text | Spinner] = self._tables() if self._sections else []
        if self._doing:
            self._spinner.update(text=Text(f"{self.title}: {self._doing}"))
            parts.append(self._spinner)
        return Group(*parts)

    def _tables(self) -> list[Table | Text | Spinner]:
        parts: list[Table | Text | Spinner] = [_table(header=True)]
        for section in self._sections:
            if section.name:
                parts.append(Text(section.name, style="bold cyan"))
            parts.append(_table(section))
        return parts


def _table(section: _Section | None = None, *, header: bool = False) -> Table:
    """Columns of the same widths for every phase; the header stands alone, above the first one's name."""
    table = Table(box=None, pad_edge=False, header_style="bold", show_header=header)
    for name, width in zip(_COLUMNS, _WIDTHS, strict=True):
        table.add_column(name, justify="right", no_wrap=True, width=width)
    if section is None:
        return table
    rows, hidden = list(section.rows), section.count - len(section.rows)
    # A finished phase shows its first and its last row, the one at work its last ones.
    before = 1 if hidden and rows[0] is section.first else 0
    for i, row in enumerate(rows):
        if hidden and i == before:
            table.add_row("", f"... {hidden} more", style="dim")
        table.add_row(*row)
    return table


def _row(record: Record, elapsed: float) -> tuple[str, ...]:
    """Format a record for the columns; a dash where a solver has no such number."""
    return (
        str(record.iteration),
        _number(record.cost, ".9g"),
        _number(record.residual, ".2e"),
        _number(record.increment, ".2e"),
        _number(record.step_length, ".3g"),
        f"{elapsed:.2f} s",
    )


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
