"""The table that grows while a solver works: live on a terminal, plain lines elsewhere.

A record costs the solver constant work: it is formatted and kept. The live picture is drawn by a thread of
its own, a few times a second whatever comes in, and is never taller than the terminal. Of many phases the
first and the last ones are kept, and the others are counted.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from collections import deque
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

from rich.console import Console, Group
from rich.live import Live
from rich.spinner import Spinner
from rich.text import Text

if TYPE_CHECKING:
    from mbocp.solution import IterationRecord

_ROWS = 12  # as many iterations of the phase at work stay in view
_PICTURES = 4  # a second; one takes about 2 ms to draw, and terminals far away take longer
_FIRST, _LAST = 3, 12  # finished phases that are kept: so many from the beginning, so many from the end
_LIVE = 3  # finished phases in the live picture, where the terminal has room for them ...
_TALL = 4  # ... with so many lines each: name, first row, "... more", last row
_FRAME = 5  # lines around: columns' names, phases before, name and "... more" of the phase at work, spinner
# Without a terminal: the first so many iterations of a phase, then every tenth, then every hundredth; and
# likewise of the phases.
_PLAIN_ROWS, _PLAIN_TENTHS = 20, 200

_COLUMNS = ("iteration", "cost", "residual", "increment", "step", "time")
_WIDTHS = (9, 15, 9, 9, 8, 8)
_BETWEEN = "  "
_LEFT_OUT_FIRST = ("increment", "step", "time")  # of a terminal that is too narrow for all


class _Section:
    """Rows of one phase."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.count, self.iteration = 0, -1
        self.first: tuple[str, ...] = ()
        self.rows: deque[tuple[str, ...]] = deque(maxlen=_ROWS)

    def is_over(self, record: IterationRecord) -> bool:
        """Whether a record belongs to the next phase; one of the same name begins with a repeated number."""
        return record.phase != self.name or record.iteration <= self.iteration

    def add(self, record: IterationRecord, row: tuple[str, ...]) -> None:
        self.count, self.iteration = self.count + 1, record.iteration
        self.first = self.first or row
        self.rows.append(row)

    def shorten(self) -> None:
        """Keep where the phase began and where it came to."""
        self.rows = deque([self.rows[-1]] if self.count == 1 else [self.first, self.rows[-1]])

    def write(self, text: Text, columns: Sequence[int], rows: int = _ROWS) -> None:
        """Append its lines: the last `rows` of the phase at work, first and last row of a finished one."""
        if self.name:
            text.append(f"{self.name}\n", style="bold cyan")
        shown = list(self.rows)[-rows:]
        hidden = self.count - len(shown)
        before = 1 if hidden and shown[0] is self.first else 0
        for i, row in enumerate(shown):
            if hidden and i == before:
                text.append(_line(("", f"... {hidden} more"), columns) + "\n", style="dim")
            text.append(_line(row, columns) + "\n")


class _Sections:
    """All phases: the first ones, a count of those between, the last ones."""

    def __init__(self) -> None:
        self.count = 0
        self.current: _Section | None = None
        self._first: list[_Section] = []
        self._last: deque[_Section] = deque()
        self._left_out = [0, 0]  # phases, iterations

    def begin(self, name: str) -> _Section:
        """Finish the phase at work and begin another."""
        if self.current is not None:
            self.current.shorten()
            self._keep(self.current)
        self.count += 1
        self.current = _Section(name)
        return self.current

    def _keep(self, section: _Section) -> None:
        if len(self._first) < _FIRST:
            self._first.append(section)
            return
        self._last.append(section)
        if len(self._last) > _LAST:
            gone = self._last.popleft()
            self._left_out = [self._left_out[0] + 1, self._left_out[1] + gone.count]

    def text(self, width: int, *, most: int = _FIRST + _LAST, rows: int = _ROWS) -> Text:
        """Table of the phases, so wide at most: of finished ones all that are kept, or the last `most`."""
        text, columns = Text(no_wrap=True, overflow="crop"), _columns_within(width)
        text.append(_line(_COLUMNS, columns) + "\n", style="bold")
        finished = [*self._first, *self._last]
        shown = finished[len(finished) - most :] if most < len(finished) else finished
        hidden = finished[: len(finished) - len(shown)]
        phases, iterations = self._left_out
        phases, iterations = phases + len(hidden), iterations + sum(section.count for section in hidden)
        gap = 0 if hidden else len(self._first)
        for i, section in enumerate(shown):
            if i == gap:
                _write_gap(text, phases, iterations)
            section.write(text, columns)
        if gap >= len(shown):
            _write_gap(text, phases, iterations)
        if self.current is not None:
            self.current.write(text, columns, rows)
        text.rstrip()
        return text


def _write_gap(text: Text, phases: int, iterations: int) -> None:
    if phases:
        text.append(f"... {phases} phases with {iterations} rows more\n", style="dim")


class ProgressCallback:
    """Callback of a solver that shows its iterations on stderr, phase after phase.

    The column `time` counts from the first record, where the solver begins.

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
        self._lock = threading.Lock()  # the picture is drawn by another thread
        self._sections = _Sections()
        self._unprinted: tuple[str, ...] = ()
        self._unnamed = 0  # phases that were left out of the log since the last one that was not
        self._begin = math.nan
        self._doing = ""
        self._live: Live | None = None

    @cached_property
    def _spinner(self) -> Spinner:
        return Spinner("dots")  # reads a table of emojis, which a log has no use for

    def __enter__(self) -> ProgressCallback:
        if not self.quiet and self._console.is_terminal:
            self._live = Live(
                console=self._console,
                refresh_per_second=_PICTURES,
                transient=True,
                get_renderable=self._picture,
            )
            self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._live is None:
            self._print_gap()
            self._print_row(self._unprinted)
            return
        self._doing = ""
        self._live.stop()
        if self._sections.current is not None and kind is None:
            self._console.print(self._sections.text(self._console.width))  # the last iterations stay

    def say(self, doing: str) -> None:
        """Show what is going on before the first iteration."""
        self._doing = doing
        if self._live is not None:
            self._live.refresh()

    def __call__(self, record: IterationRecord) -> None:
        """Show an iteration."""
        moment = time.perf_counter()
        self._begin = moment if math.isnan(self._begin) else self._begin
        row = _row(record, moment - self._begin)
        with self._lock:
            section = self._sections.current
            is_new = section is None or section.is_over(record)
            if section is None or is_new:
                section = self._sections.begin(record.phase)
            section.add(record, row)
            self._doing = record.phase
        if self._live is None and not self.quiet:
            self._print_plain(section, row, is_new=is_new)

    def _print_plain(self, section: _Section, row: tuple[str, ...], *, is_new: bool) -> None:
        is_named = self._sections.count % _every(self._sections.count) == 0
        if is_new:
            self._unnamed += not is_named
            if is_named:
                self._print_gap()
                self._print_row(self._unprinted)  # where the phase before came to
                if self._sections.count == 1:
                    self._print_row(_COLUMNS)
                self._print_line(section.name)
        is_shown = is_named and section.count % _every(section.count) == 0
        if is_shown:
            self._print_row(row)
        self._unprinted = () if is_shown else row

    def _print_gap(self) -> None:
        if self._unnamed:
            self._print_line(f"... {self._unnamed} phases more")
        self._unnamed = 0

    def _print_row(self, row: tuple[str, ...]) -> None:
        self._print_line(_line(row))

    def _print_line(self, line: str) -> None:
        if line and not self.quiet:
            self._console.file.write(line + "\n")

    def _picture(self) -> Group:
        """As many phases and iterations as the terminal has room for, and what is going on."""
        rows = max(1, min(_ROWS, self._console.height - _FRAME))
        most = max(0, min(_LIVE, (self._console.height - _FRAME - _ROWS) // _TALL))
        width = self._console.width
        with self._lock:
            doing, is_begun = self._doing, self._sections.current is not None
            parts: list[Text | Spinner] = (
                [self._sections.text(width, most=most, rows=rows)] if is_begun else []
            )
        if doing:
            self._spinner.update(text=Text(f"{self.title}: {doing}", no_wrap=True, overflow="crop"))
            parts.append(self._spinner)
        return Group(*parts)


def _every(count: int) -> int:
    """Which of so many are shown in a log: all, every tenth, every hundredth."""
    return 1 if count <= _PLAIN_ROWS else 10 if count <= _PLAIN_TENTHS else 100


def _columns_within(width: int) -> list[int]:
    """Columns for which there is room."""
    kept = list(range(len(_COLUMNS)))
    for name in _LEFT_OUT_FIRST:
        if sum(_WIDTHS[k] for k in kept) + len(_BETWEEN) * (len(kept) - 1) > width:
            kept.remove(_COLUMNS.index(name))
    return kept


def _line(row: Sequence[str], columns: Iterable[int] = range(len(_COLUMNS))) -> str:
    """Columns of the same widths for every phase; short rows are notes."""
    return _BETWEEN.join(row[k].rjust(_WIDTHS[k]) for k in columns if k < len(row))


def _row(record: IterationRecord, elapsed: float) -> tuple[str, ...]:
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
