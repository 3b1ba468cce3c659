"""The page of keys, from their declarations.

``python -m mbocp.problem.file.keys_page docs/keys.md`` writes the lists of the page.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mbocp._arrays import dataclass
from mbocp._keys import Key, default_of, key_of, keys_of, tables_in, takes_of
from mbocp.problem.file.frame_table import FrameGoalTable
from mbocp.problem.file.read_tables import ProblemTable

FRAME = "goal.frame"  # where the keys of frames are described, which stand in several tables
HOME = "problem_files.md"  # the page that links within what keys say are of
_TABLES = {"table": "[{}]", "tables": "[[{}]]"}  # how the file writes them
_LINK = re.compile(r"(?<=\]\()(?=#)")
_LISTS = re.compile(r"(?<=\n)## `.*", re.DOTALL)


@dataclass(frozen=True)
class Row:
    """What the page says of one key, or of several that belong together."""

    names: tuple[str, ...]
    takes: str
    unit: str
    default: str
    says: str

    def markdown(self) -> str:
        """Return a heading and a sentence of a table of the file, a line of a list of a key within one."""
        says, depth = _LINK.sub(HOME, self.says), self.names[0].count(".")
        if depth:
            names = ", ".join(f"`{_split(name)[1]}`" for name in self.names)
            return f"{'  ' * (depth - 1)}- {names}{self.brackets()}: {says}\n"
        if self.takes in _TABLES:
            return f"\n## `{_TABLES[self.takes].format(self.names[0])}`\n\n{_sentence(says)}.\n\n"
        return f"\n## `{self.names[0]}`\n\n{_sentence(says)}{self.brackets()}.\n\n"

    def brackets(self) -> str:
        """Return what it takes, its unit and its default, in brackets."""
        parts = [f"{self.takes} [{self.unit}]" if self.unit else self.takes]
        if self.default.startswith("required"):
            parts.append(self.default)
        elif self.default not in ("", "none", "nothing"):
            parts.append(f"default {self.default}")
        return f" ({'; '.join(parts)})"


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
    """Return a page with its lists of keys as they are now."""
    lists = "".join(row.markdown() for name, row in rows().items() if name == row.names[0])
    return _LISTS.sub(lambda _: lists.strip() + "\n", page)


def _split(name: str) -> tuple[str, str]:
    """What a key is under, with the dot, and its last name."""
    under, dot, leaf = name.rpartition(".")
    return under + dot, leaf


def _sentence(words: str) -> str:
    """Words that begin with a capital, that of a link's text where they begin with a link."""
    place = words.startswith("[")
    return words[:place] + words[place].upper() + words[place + 1 :]


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        path = Path(argument)
        path.write_text(update_page(path.read_text(encoding="utf-8")), encoding="utf-8")
