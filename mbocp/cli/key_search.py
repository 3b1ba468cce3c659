"""Keys by name, by the last part of a name or by a word: those of problem files, then those of robot.toml."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from mbocp._keys import without_links
from mbocp._text import show
from mbocp.exceptions import InvalidValue

if TYPE_CHECKING:
    from mbocp.problem.file.keys_page import Row

_INDEX = re.compile(r"\[\w+\]|\.\d+(?=\.|$)")  # path.0.kind and path[0].kind are path.kind
_CLOSE = 0.8  # share of letters that a name and a misspelling of it have in common: hover is no solver
_WHERE = "of robot.toml: docs/robot_toml.md"


def find_keys(known: Mapping[str, Row], name: str | None, *, every: bool) -> Mapping[str, Row]:
    """Return the keys that are asked for; those of tables in tables by name, or if `every` one is.

    Raises
    ------
    InvalidValue
        If there is none; it says near misses.
    """
    at_home = known if every else {key: row for key, row in known.items() if key in row.names}
    if name is None:
        return at_home
    asked = _INDEX.sub("", name)
    found = {key: row for key, row in known.items() if f"{key}.".startswith(f"{asked}.")}
    if found := found or _by_part(at_home, asked) or _of_robots(asked):
        return found
    near = _near(asked, known)
    hint = f"did you mean {near}?" if near else "`mbocp keys` lists them, docs/wishes.md has examples"
    raise InvalidValue("NAME", show(name), f"a key of problem files; {hint}")


def _by_part(known: Mapping[str, Row], asked: str) -> dict[str, Row]:
    """Keys of which it is the last part, or one in the middle, or whose meaning has the word."""
    from mbocp.problem.file.messages import OTHER_WORDS

    word = _word(asked)
    ends = tuple(f".{end}" for end in (asked, *OTHER_WORDS.get(asked, ())[:1]))
    within = f".{asked}."
    found = {key: row for key, row in known.items() if key.endswith(ends) or within in f".{key}."}
    return found | {key: row for key, row in known.items() if word.search(without_links(row.says))}


def _word(asked: str) -> re.Pattern[str]:
    return re.compile(rf"\b{re.escape(asked)}", re.IGNORECASE)


def _of_robots(asked: str) -> dict[str, Row]:
    """Tables and keys of robot.toml in whose name, type, keys or meaning the word is."""
    word = _word(asked.removeprefix("robot."))
    return {
        name: row
        for name, row in _robot_rows()
        if word.search(name) or word.search(without_links(row.says).removesuffix(_WHERE))
    }


def _robot_rows() -> Iterator[tuple[str, Row]]:
    """A row for each kind of table of robot.toml, and one for each key that is no table."""
    from mbocp._keys import default_of, key_of, takes_of
    from mbocp.problem.file.keys_page import Row
    from mbocp.robot.loading.robot_toml import TABLES, RobotTable, types_of

    for field, info in RobotTable.model_fields.items():
        key = info.alias or field
        if key not in TABLES:
            declared = key_of(info)
            says = f"{declared.says}; {_WHERE}" if declared is not None else _WHERE
            yield key, Row((key,), takes_of(info), "", default_of(info), says)
            continue
        takes = takes_of(info)
        for table in TABLES[key]:
            of_type = types_of(table)
            heading = f"[[{key}]]" if takes == "tables" else f"[{key}]"
            name = f'{heading} type = "{of_type[0]}"' if len(of_type) == 1 else heading
            meaning = (table.__doc__ or "").split("\n\n")[0].rstrip(".")
            keys = ", ".join(one for one in table.model_fields if one != "type" or len(of_type) != 1)
            yield name, Row((name,), takes, "", "", f"{f'{meaning}; ' * bool(meaning)}keys: {keys}; {_WHERE}")


def _near(asked: str, known: Mapping[str, Row]) -> str:
    """Names of which it is a misspelling in whatever case, as whole or by their last part; "" without."""
    inner_first = sorted(known, key=lambda key: -key.count("."))
    names = {key.rpartition(".")[2]: key for key in inner_first} | {key: key for key in known}
    names |= {word: word for name, _ in _robot_rows() for word in re.findall(r"\w{3,}", name)}
    close = difflib.get_close_matches(asked.casefold(), names, cutoff=_CLOSE)  # all of them are small letters
    return " or ".join(show(names[one]) for one in close)
