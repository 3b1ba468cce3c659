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

_ROWS = 12  # as many iterations stay in view
_PERIOD = 0.05  # [s] between two pictures: a Newton step may take a millisecond, drawing takes longer
_PLAIN_ROWS = 20  # without a terminal: the first so many iterations, then every tenth, and the last

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


class Progress:
    """Callback of a solver that shows its iterations on stderr.

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
        self._rows: deque[tuple[str, ...]] = deque(maxlen=_ROWS)
        self._unprinted: tuple[str, ...] = ()
        self._count = 0
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
        if self._count and kind is None:
            self._console.print(self._table())  # the last iterations stay

    def say(self, doing: str) -> None:
        """Show what is going on before the first iteration."""
        self._doing = doing
        self._draw(now=True)

    def __call__(self, record: Record) -> None:
        """Show an iteration."""
        self._count += 1
        self._doing = record.phase
        row = _row(record, time.perf_counter() - self._begin)
        self._rows.append(row)
        if self._live is None:
            self._print_plain(row)
        else:
            self._draw(now=False)

    def _draw(self, *, now: bool) -> None:
        moment = time.perf_counter()
        if self._live is not None and (now or moment - self._drawn > _PERIOD):
            self._drawn = moment
            self._live.update(self._picture(), refresh=True)

    def _print_plain(self, row: tuple[str, ...]) -> None:
        if self._count == 1:
            self._print_row(_COLUMNS)
        self._unprinted = row
        if self._count <= _PLAIN_ROWS or self._count % 10 == 0:
            self._print_row(row)
            self._unprinted = ()

    def _print_row(self, row: tuple[str, ...]) -> None:
        if row and not self.quiet:
            self._console.file.write("  ".join(n.rjust(w) for n, w in zip(row, _WIDTHS, strict=True)) + "\n")

    def _picture(self) -> Group:
        parts: list[Table | Spinner | Text] = [self._table()] if self._rows else []
        if self._doing:
            self._spinner.update(text=Text(f"{self.title}: {self._doing}"))
            parts.append(self._spinner)
        return Group(*parts)

    def _table(self) -> Table:
        table = Table(box=None, pad_edge=False, header_style="bold")
        for name in _COLUMNS:
            table.add_column(name, justify="right", no_wrap=True)
        if self._count > len(self._rows):
            table.add_row(f"... {self._count - len(self._rows)} more", style="dim")
        for row in self._rows:
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
