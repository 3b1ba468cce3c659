"""Tables for a terminal (rich) or for the documentation (Markdown)."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

__all__ = ["Table", "present", "put_into", "show"]

_END = "<!-- end of tables -->"


@dataclass(frozen=True)
class Table:
    """A title, the columns' names, rows of text, and what has to be said about them."""

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    note: str = ""

    def markdown(self) -> str:
        lines = [f"**{self.title}**", "", _line(self.columns), _line(["---"] * len(self.columns))]
        lines += [_line(row) for row in self.rows]
        return "\n".join(lines + (["", self.note] if self.note else []))

    def to_csv(self, path: Path) -> None:
        """Write the rows into a file, for tables that are too long for a page."""
        with path.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([self.columns, *self.rows])

    def rich(self) -> RichTable:
        """As a rich table; `Text`, because brackets around units are no markup."""
        title = Text(self.title, style="bold")
        table = RichTable(title=title, title_justify="left", box=None, pad_edge=False)
        for i, name in enumerate(self.columns):
            table.add_column(Text(name, style="dim"), justify="left" if i == 0 else "right")
        for row in self.rows:
            table.add_row(*map(Text, row))
        return table


def show(table: Table, *, markdown: bool = False) -> None:
    """Print a table on stdout."""
    if markdown:
        print(table.markdown(), end="\n\n", flush=True)
        return
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(width=140, highlight=False)  # nobody looks at a pipe through a narrow window
    console.print(table.rich())
    if table.note:
        console.print(Text(table.note, style="dim"))
    console.print()


def present(tables: Sequence[Table], page: Path, begin: str, *, into_page: bool) -> None:
    """Print tables, and put them into a Markdown file if that is asked."""
    for table in tables:
        show(table)
    if into_page:
        put_into(page, begin, tables)


def put_into(page: Path, begin: str, tables: Sequence[Table]) -> None:
    """Replace what stands in a Markdown file between the line `begin` and the end of the tables."""
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    _, ended, after = rest.partition(_END)
    if not (found and ended):
        raise SystemExit(f"{page}: has no lines {begin} and {_END}")
    text = "\n\n".join(table.markdown() for table in tables)
    page.write_text(f"{before}{begin}\n\n{text}\n\n{_END}{after}", encoding="utf-8")


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
