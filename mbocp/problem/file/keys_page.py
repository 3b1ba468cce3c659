"""The page of keys, from their declarations.

``python -m mbocp.problem.file.keys_page docs/problem_files.md`` writes the tables of the page.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mbocp._dataclass import dataclass
from mbocp._keys import Key, default_of, key_of, keys_of, tables_in, takes_of
from mbocp.problem.file.frame_table import FrameGoalTable
from mbocp.problem.file.schema import ProblemTable

FRAME = "goal.frame"  # where the keys of frames are described, which stand in several tables
_TABLE = re.compile(r"(\| key (?:of `(?P<under>[\w.]+)` )?\|[^\n]*\n\|[-|]+\n)(?:\|[^\n]*\n)+")


@dataclass(frozen=True)
class Row:
    """What the page says of one key, or of several that belong together."""

    names: tuple[str, ...]
    takes: str
    unit: str
    default: str
    says: str

    def markdown(self, under: str = "") -> str:
        """Return a row of a table; names are those `under` a table."""
        names = ", ".join(f"`{name.removeprefix(under)}`" for name in self.names)
        takes = f"{self.takes} [{self.unit}]" if self.unit else self.takes
        default = "" if self.default in ("none", "nothing") else self.default
        cells = (names, takes, default, self.says)
        return "|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|"


def all_keys(table: type[BaseModel] = ProblemTable, under: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """Yield dotted names of all keys with their fields, each table before what it holds."""
    for field, info in table.model_fields.items():
        name = f"{under}{info.alias or field}"
        yield name, info
        for inner in tables_in(info.annotation):
            yield from all_keys(inner, f"{name}.")


def rows() -> dict[str, Row]:
    """Return the row that describes each key, by dotted name.

    Keys of tables within tables (`phase.limits`, `goal.any`) share that of the same declaration further out.
    """
    named = [(*_split(name), info, key) for name, info in all_keys() if (key := key_of(info)) is not None]
    homes: dict[tuple[str, Key], str] = {}
    for under, leaf, _, key in sorted(named, key=lambda one: one[0].count(".")):
        homes.setdefault((leaf, key), under)
    frames = keys_of(FrameGoalTable)
    found: dict[str, Row] = {}
    for under, leaf, info, key in named:
        home, leaves = homes[leaf, key], (leaf, *key.beside)
        if frames.get(leaf) == key:
            home = f"{FRAME}."
        elif home.count(".") == under.count("."):
            home = under
        row = Row(tuple(home + one for one in leaves), takes_of(info), key.unit, default_of(info), key.says)
        found |= {under + one: row for one in leaves}
    return found


def update_page(page: str) -> str:
    """Return a page with its tables of keys as they are now."""
    described = [row for name, row in rows().items() if name == row.names[0]]

    def table(found: re.Match[str]) -> str:
        under = f"{found['under']}." if found["under"] else ""
        mine = [row for row in described if row.names[0].startswith(f"{FRAME}.") == bool(under)]
        return found[1] + "".join(f"{row.markdown(under)}\n" for row in mine)

    return _TABLE.sub(table, page)


def _split(name: str) -> tuple[str, str]:
    """What a key is under, with the dot, and its last name."""
    under, dot, leaf = name.rpartition(".")
    return under + dot, leaf


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        path = Path(argument)
        path.write_text(update_page(path.read_text(encoding="utf-8")), encoding="utf-8")
