"""The keys of problem files: which there are by their schema, and what the pages say of each.

The schema (`mbocp.problem.file.schema`) knows names; what they take, units, defaults and meanings
stand in the tables of `problem_files.md` and `robots.md`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

from mbocp.problem.file.schema import ProblemTable

DOCS = Path(__file__).parent.parent
_CELL = re.compile(r"(?<!\\)\|")
_NAME = re.compile(r"`([a-z_]+(?:\.[a-z_]+)*)`")
_LINK = re.compile(r"\]\((#[^)]+)\)")


@dataclass(frozen=True)
class Key:
    """One key; `name` is dotted, `tables` are the tables that it may be."""

    name: str
    tables: tuple[type[BaseModel], ...]


@dataclass(frozen=True)
class Row:
    """What a page says of one key, or of several that belong together."""

    names: str
    takes: str
    unit: str
    default: str
    says: str

    def markdown(self) -> str:
        """A row of a table."""
        cells = (self.names, self.takes, self.unit, self.default, self.says)
        return "|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|"


HEAD = "| key | takes | unit | default | meaning |\n|---|---|---|---|---|"
# Tables that hold in several places, where the page explains them, and under which heading.
EXPLAINED = {
    "FrameGoalTable": ("goal.frame", "problem_files.md", "| key of `goal.frame` |"),
    "PayloadTable": ("robot.payload", "robots.md", "## Payloads"),
    "PartTable": ("robot.part", "robots.md", "## Several robots in one world"),
}


def all_keys(table: type[BaseModel] = ProblemTable, under: str = "") -> Iterator[Key]:
    """All keys, each table before what it holds; a table that contains itself is not entered twice."""
    for field, info in table.model_fields.items():
        name = f"{under}{info.alias or field}"
        found = tuple(dict.fromkeys(_tables(info.annotation)))
        yield Key(name, found)
        for inner in found:
            yield from all_keys(inner, f"{name}.")


def _tables(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _tables(argument)


def described() -> dict[str, Row]:
    """What the pages say, by dotted name."""
    found = _rows("problem_files.md", "| key | type |", "")
    for under, page, heading in EXPLAINED.values():
        found |= _rows(page, heading, f"{under}.")
    return found


def explained(key: Key, rows: dict[str, Row]) -> bool:
    """Whether a page says what a key means: in its own row, or in that of the same table elsewhere."""
    return any(name in rows for name in _homes(key.name)) or bool(key.tables)


def row_of(name: str, rows: dict[str, Row]) -> Row | None:
    """The row of a key, or of its namesake in the table that explains it."""
    return next((rows[home] for home in _homes(name) if home in rows), None)


def _homes(name: str) -> Iterator[str]:
    """Where a key may be explained: by its own name, or as a key of the table that it is shared with."""
    yield name
    yield re.sub(r"^(?:phase\.)?(?:start|via|goal\.any|goal)\.frame\.", "goal.frame.", name)
    yield re.sub(r"^robot\.part\.payload\.", "robot.payload.", name)
    yield re.sub(r"^robot\.part\.(?=(?:mass|com|inertia|box|sphere|cylinder)$)", "robot.payload.", name)
    yield re.sub(r"^robot\.part\.", "robot.", name)
    yield re.sub(r"^phase\.(?=(?:limits|cost|path|via)\.)", "", name)
    yield re.sub(r"^goal\.any\.", "goal.", name)
    yield re.sub(r"^phase\.release\.", "phase.hold.", name)
    yield re.sub(r"^(cost\.(?:\w+_weights|target))\.\w+$", r"\1", name)


def _rows(page: str, after: str, under: str) -> dict[str, Row]:
    """Rows of the first table with keys at or behind some text of a page."""
    text = (DOCS / page).read_text(encoding="utf-8")
    lines = text[text.index(after) :].splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("| key"))
    found: dict[str, Row] = {}
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            break
        first, *cells = (cell.strip() for cell in _CELL.split(line)[1:-1])
        shown = _NAME.sub(lambda name: f"`{under}{name.group(1)}`", first)
        says = (_LINK.sub(rf"]({page}\1)", cell) for cell in (*cells, "", "")[:4])
        row = Row(shown, *says)
        found |= dict.fromkeys(_NAME.findall(shown), row)
    return found
