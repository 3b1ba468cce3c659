"""Rows of the documentation's table of keys that follow from the terms.

``python -m mbocp.problem.file.keys_page docs/problem_files.md`` writes them into the page.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import get_type_hints

from mbocp.terms import COST_TERMS, PATH_KEYS
from mbocp.terms.written import Key, Table

_PATH_HEAD = {
    "name": Key(
        "string",
        "",
        "kind and frame",
        "what a [path constraint](#path-constraints) is called; one table `[[path]]` each",
    ),
    "kind": Key("string", "", "required", ", ".join(f'`"{kind}"`' for kind in PATH_KEYS)),
    "frame": Key(
        "string", "", "required, but for a contact force", "frame of the robot that is meant, or its origin"
    ),
    "from": Key(
        "number, name of a via point or a phase, `{ share = number }`, or `{ phase = name, share = number }`",
        "s, or part of the horizon",
        "the whole motion",
        "when it holds, both ends included",
        ("until",),
    ),
}


def key_rows() -> dict[str, list[str]]:
    """Rows of the tables `cost` and `path`, in Markdown."""
    path = _collected(list(PATH_KEYS.values()))
    return {
        "cost": _rows("cost", _collected([term.Keys for term in COST_TERMS])),
        "path": _rows("path", {**_PATH_HEAD, **path}),
    }


def updated(page: str) -> str:
    """A page with the rows of both tables as they are now."""
    rows, lines = key_rows(), []
    for table, block in groupby(page.splitlines(), key=_table_of):
        lines += rows[table] if table in rows else list(block)
    return "\n".join(lines) + "\n"


def _table_of(line: str) -> str:
    found = re.match(r"\| `(cost|path)\.\w+`", line)
    return found.group(1) if found else ""


def _collected(tables: Sequence[type[Table]]) -> dict[str, Key]:
    """What is said of each key, by the first key of its row."""
    found: dict[str, Key] = {}
    for table in tables:
        for name, hint in get_type_hints(table, include_extras=True).items():
            for key in getattr(hint, "__metadata__", ()):
                if isinstance(key, Key):
                    row = next((first for first, old in found.items() if name in (first, *old.beside)), name)
                    found[row] = _together(found[row], key) if row in found else key
    return found


def _together(old: Key, new: Key) -> Key:
    """One line on a key of several kinds."""
    units = dict.fromkeys([*old.unit.split(", "), *new.unit.split(", ")])
    return replace(old, unit=", ".join(units), says=f"{old.says}; {new.says}")


def _rows(table: str, keys: dict[str, Key]) -> list[str]:
    return [_row([f"`{table}.{k}`" for k in (name, *key.beside)], key) for name, key in keys.items()]


def _row(names: Iterable[str], key: Key) -> str:
    cells = [", ".join(names), key.takes, key.unit, key.default, key.says]
    return "|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|"


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        path = Path(argument)
        path.write_text(updated(path.read_text(encoding="utf-8")), encoding="utf-8")
