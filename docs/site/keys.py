"""The keys of problem files as the site has them: from their declarations, and for parts from `robots.md`.

Keys are declared in the package (`mbocp._keys`); those of payloads and parts stand in tables of `robots.md`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from mbocp._keys import tables_in
from mbocp.problem.file import keys_page
from mbocp.problem.file.keys_page import Row

DOCS = Path(__file__).parent.parent
_CELL = re.compile(r"(?<!\\)\|")
_NAME = re.compile(r"`([a-z_]+(?:\.[a-z_]+)*)`")
_LINK = re.compile(r"\]\((#[^)]+)\)")

HEAD = "| key | takes | default | meaning |\n|---|---|---|---|"
# Tables that `robots.md` explains, and under which heading.
EXPLAINED = {"robot.payload": "## Payloads", "robot.part": "## Several robots in one world"}


def all_keys() -> dict[str, bool]:
    """All keys by dotted name, and whether each is a table with keys of its own."""
    return {name: bool(tables_in(info.annotation)) for name, info in keys_page.all_keys()}


def described() -> dict[str, Row]:
    """What is said of each key, by dotted name."""
    found = {name: _linked(row, "problem_files.md") for name, row in keys_page.rows().items()}
    for under, heading in EXPLAINED.items():
        found |= _rows("robots.md", heading, f"{under}.")
    return found | {name: row for name in all_keys() if name not in found and (row := _shared(name, found))}


def _shared(name: str, rows: dict[str, Row]) -> Row | None:
    """The row of a key of parts that is one of payloads, and of weights as a whole."""
    of_body = re.sub(r"^robot\.part\.(?:payload\.)?", "robot.payload.", name)
    of_weights = re.sub(r"(_weights)\.\w+$", r"\1", name)
    return next((rows[home] for home in (of_body, of_weights) if home in rows), None)


def _linked(row: Row, page: str) -> Row:
    return replace(row, says=_LINK.sub(rf"]({page}\1)", row.says))


def _rows(page: str, after: str, under: str) -> dict[str, Row]:
    """Rows of the first table with keys at or behind some text of a page."""
    text = (DOCS / page).read_text(encoding="utf-8")
    found: dict[str, Row] = {}
    for cells in _cells(text[text.index(after) :].splitlines()):
        names = tuple(f"{under}{name}" for name in _NAME.findall(cells[0]))
        takes, default, says = (*cells[1:], "", "")[:3]
        found |= dict.fromkeys(names, _linked(Row(names, takes, "", default, says), page))
    return found


def _cells(lines: list[str]) -> Iterator[list[str]]:
    start = next(i for i, line in enumerate(lines) if line.startswith("| key"))
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            break
        yield [cell.strip() for cell in _CELL.split(line)[1:-1]]
