"""How a table of the paper looks beside mbocp's numbers: on a terminal, and in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from rich.console import Console, Group
from rich.padding import Padding
from rich.table import Table as RichTable
from rich.text import Text

WIDTH = 120  # letters that a table may be wide

Kind = Literal["label", "paper", "mbocp", "ratio"]

_STYLES: Mapping[Kind, str] = {"label": "", "paper": "cyan", "mbocp": "bold", "ratio": "green"}


@dataclass(frozen=True)
class Column:
    """A column: the heads that it shares with its neighbours, its own name, and whose numbers it holds."""

    group: str
    name: str
    kind: Kind = "mbocp"

    @property
    def title(self) -> str:
        """Both on one line."""
        return f"{self.group}: {self.name}" if self.group and self.name else self.group or self.name


@dataclass(frozen=True)
class Section:
    """Blocks of rows under a heading; a block is what belongs to one step size."""

    title: str
    blocks: Sequence[Sequence[tuple[str, ...]]]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class PaperTable:
    """One table, with the paper's numbers and mbocp's.

    Attributes
    ----------
    number : int or None
        None: it is no table of the paper.
    title : str
    columns : tuple of Column
    sections : tuple of Section
    notes : tuple of str
        What has to be said about all of it.
    data : mapping
        The numbers themselves, for JSON.
    """

    number: int | None
    title: str
    columns: tuple[Column, ...]
    sections: tuple[Section, ...]
    notes: tuple[str, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)

    def rich(self, width: int = WIDTH) -> Group:
        """For a console so many letters wide; where columns do not fit, they follow below."""
        heading = self.title if self.number is None else f"Table {self.number}  {self.title}"
        parts: list[Any] = [Text(heading, style="bold")]
        for section in self.sections:
            if section.title:
                parts.append(Text(f"\n{section.title}", style="italic"))
            for i, columns in enumerate(self._pieces(section, width)):
                parts += [Text("")] * bool(i) + [self._grid(section, columns, width)]
            parts += [_note(note) for note in section.notes]
        parts += [_note(note) for note in self.notes]
        return Group(*parts)

    def print(self, console: Console) -> None:
        """Print it, with an empty line behind."""
        console.print(self.rich(min(WIDTH, console.width)), width=WIDTH)
        console.print()

    def markdown(self) -> str:
        """For the documentation, which has the title, and says once what is said here of every table."""
        lines: list[str] = []
        for section in self.sections:
            if len(self.sections) > 1:
                lines += [f"{section.title}:", ""]
            lines += [_line([c.title for c in self.columns]), _line(["---"] * len(self.columns))]
            lines += [_line(row) for block in section.blocks for row in block]
            lines.append("")
            lines += [f"- {note}" for note in section.notes]
            lines += [""] * bool(section.notes)
        return "\n".join(lines).strip() + "\n"

    def _widths(self, section: Section) -> list[int]:
        """Letters that each column needs."""
        rows = [row for block in section.blocks for row in block]
        heads = [max(map(len, head.split("\n"))) for head in self._heads(range(len(self.columns)))]
        return [max([head, *(len(row[i]) for row in rows)]) for i, head in enumerate(heads)]

    def _pieces(self, section: Section, width: int) -> list[list[int]]:
        """Columns that stand beside each other: the labels, and as many groups of the others as fit."""
        wide = self._widths(section)
        labels = [i for i, column in enumerate(self.columns) if column.kind == "label"]
        groups: list[list[int]] = []
        for i, column in enumerate(self.columns):
            if column.kind == "label":
                continue
            if groups and column.group and column.group == self.columns[groups[-1][-1]].group:
                groups[-1].append(i)
            else:
                groups.append([i])
        pieces = [labels]
        for group in groups:
            together = sorted([*pieces[-1], *group])
            fits = sum(wide[i] + 1 for i in together) <= width + 1
            if fits or pieces[-1] == labels:
                pieces[-1] = together
            else:
                pieces.append(sorted([*labels, *group]))
        return pieces

    def _grid(self, section: Section, columns: Sequence[int], width: int) -> RichTable:
        wide = self._widths(section)
        gap = 2 if sum(wide[i] + 2 for i in columns) <= width + 2 else 1
        table = RichTable(box=None, pad_edge=False, padding=(0, gap, 0, 0), header_style="dim")
        for i, head in zip(columns, self._heads(columns), strict=True):
            kind = self.columns[i].kind
            justify: Literal["left", "right"] = "left" if kind == "label" else "right"
            table.add_column(Text(head), justify=justify, style=_STYLES[kind], no_wrap=True)
        for block in section.blocks:
            for row in block:
                table.add_row(*(_cell(row[i]) for i in columns))
            if block is not section.blocks[-1] and len(block) > 1:
                table.add_row()
        return table

    def _heads(self, columns: Iterable[int]) -> list[str]:
        """Heads on two lines; what columns share is over the first of them."""
        heads, before = [], None
        for column in (self.columns[i] for i in columns):
            group = column.group if column.group != before else ""
            heads.append(f"{group}\n{column.name}")
            before = column.group
        return heads


def norm(value: float | None) -> str:
    """As the paper prints a norm."""
    return "" if value is None else f"{value:.6e}"


def milliseconds(seconds: float) -> str:
    """Time with its unit, three digits."""
    if seconds != seconds:  # NaN: nothing was measured
        return "-"
    text = f"{1e3 * seconds:#.3g} ms" if seconds < 1.0 else f"{seconds:#.3g} s"
    return text.replace(". ", " ")


def ratio(value: float) -> str:
    """Two or three digits, thousands apart."""
    if value != value:
        return "-"
    return f"{float(f'{value:.3g}'):,.0f}" if value >= 10 else f"{value:#.2g}"


def _cell(text: str) -> Text:
    return Text(text, style="bold red") if text.startswith("no (") else Text(text)


def _note(text: str) -> Padding:
    return Padding(Text(text, style="dim"), (0, 0, 0, 2))


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
