"""Where results are printed."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable
from typing import IO, Any, cast

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

_PIPE_WIDTH = 200  # nobody looks at the lines of a pipe through a narrow window
_WIDTHS = range(20, 10_000)  # that COLUMNS may ask for
_BLANKS = re.compile(r"[ ]+(?=\n)")
_HELD = "\ue000"  # stands for a blank at which no line breaks: rich breaks at Unicode's own, too
_BEFORE_UNITS = re.compile(
    r"(?<=\d) (?=(?:%|(?:rad|deg|mm|kg|ms|us|kB|MB|GB|[msNWJVA])\b))"
    r"|(?<=\bN) (?=[ms]\b)|(?<=\bkg) (?=m\b)|(?<=\bm) (?=s\b)"
)


class _Output(Console):
    """A console that breaks no line between a number and its unit."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        options = options or self.options
        if isinstance(renderable, str):
            renderable = self.render_str(renderable, highlight=options.highlight, markup=options.markup)
        if not isinstance(renderable, Text):
            return super().render(renderable, options)
        held = renderable.copy()
        held.plain = _BEFORE_UNITS.sub(_HELD, held.plain)
        parts = super().render(held, options)
        return (Segment(text.replace(_HELD, " "), style, control) for text, style, control in parts)

    def on_broken_pipe(self) -> None:
        """Leave it to `reporting`; rich would end with status 1, which means "not converged" here."""
        raise BrokenPipeError


class _TrimmedStream:
    """A text stream without the blanks that fill the lines of tables."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        return self._stream.write(_BLANKS.sub("", text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def output() -> Console:
    """Return a console for stdout: as wide as the terminal, as COLUMNS says, or wide if it is a pipe."""
    console = _Output(highlight=False)
    if console.is_terminal:
        return console
    asked = os.environ.get("COLUMNS", "")
    width = int(asked) if re.fullmatch(r"[0-9]{1,5}", asked) else _PIPE_WIDTH
    return _Output(
        file=cast("IO[str]", _TrimmedStream(sys.stdout)),
        width=width if width in _WIDTHS else _PIPE_WIDTH,
        highlight=False,
    )


def plain_table(*columns: str, header_style: str = "italic", show_header: bool = True) -> Table:
    """Return a table without lines around its cells."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.header_style, table.show_header = header_style, show_header
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def count(number: int, one: str, many: str = "") -> str:
    """Return a number of things in words."""
    return f"{number} {one if number == 1 else many or one + 's'}"
