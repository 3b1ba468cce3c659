"""`mbocp keys`: the keys of problem files, from their declarations; `mbocp schema`: the same for editors."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from mbocp._keys import without_links
from mbocp._text import show
from mbocp.cli.app import Json, argument, output_file
from mbocp.cli.console import output, plain_table
from mbocp.cli.solve import check_output
from mbocp.exceptions import InvalidValue, suggest

if TYPE_CHECKING:
    from mbocp.problem.file.keys_page import Row

_INDEX = re.compile(r"\[\w+\]|\.\d+(?=\.|$)")  # path.0.kind and path[0].kind are path.kind
SCHEMA_FILE = "mbocp.schema.json"  # the name by which problem files beside it know it


def keys(
    name: Annotated[
        str | None,
        argument("NAME", "A key, a table, the last part of a name, or a word. [default: all]"),
    ] = None,
    as_json: Json = False,
) -> None:
    """Say what keys of problem files take and mean."""
    from mbocp.problem.file.keys_page import rows

    chosen = _choose(rows(), name, every=as_json)
    if as_json:
        typer.echo(json.dumps([_facts(key, row) for key, row in chosen.items()], indent=2))
        return
    lines: dict[tuple[str, Row], list[str]] = {}  # keys beside each other that one row describes
    for key, row in chosen.items():
        lines.setdefault((key.rpartition(".")[0], row), []).append(key)
    table = plain_table("key", "takes", "unit", "default", "meaning")
    table.columns[0].no_wrap = True
    for (under, row), (first, *others) in lines.items():
        names = ", ".join([first, *(other.removeprefix(f"{under}.") for other in others)])
        cells = (row.takes, row.unit, row.default, row.says)
        table.add_row(Text(names, style="bold"), *(Text(without_links(cell)) for cell in cells))
    output().print(table)


def _choose(known: Mapping[str, Row], name: str | None, *, every: bool) -> Mapping[str, Row]:
    """The keys that are asked for; those of tables in tables by name, or if `every` one is."""
    from mbocp.problem.file.messages import OTHER_WORDS

    at_home = known if every else {key: row for key, row in known.items() if key in row.names}
    if name is None:
        return at_home
    asked = _INDEX.sub("", name)
    found = {key: row for key, row in known.items() if f"{key}.".startswith(f"{asked}.")}
    if not found:
        word = re.compile(rf"\b{re.escape(asked)}", re.IGNORECASE)
        ends = tuple(f".{end}" for end in (asked, *OTHER_WORDS.get(asked, ())[:1]))
        within = f".{asked}."
        found = {key: row for key, row in at_home.items() if key.endswith(ends) or within in f".{key}."}
        found |= {key: row for key, row in at_home.items() if word.search(without_links(row.says))}
    if not found:
        near = suggest(asked, known)
        hint = near if near.startswith("did") else "`mbocp keys` lists them, docs/wishes.md has examples"
        raise InvalidValue("NAME", show(name), f"a key of problem files; {hint}")
    return found


def _facts(key: str, row: Row) -> dict[str, str]:
    cells = {"takes": row.takes, "unit": row.unit, "default": row.default, "says": row.says}
    return {"key": key, **{name: without_links(words) for name, words in cells.items()}}


def schema(
    output: Annotated[Path | None, output_file("FILE.json", "File to write. [default: the screen]")] = None,
) -> None:
    """Write the JSON schema of problem files.

    Editors complete, check and explain their keys by it.
    """
    from mbocp.problem.file.schema import problem_schema
    from mbocp.solution.atomic import replace_text

    text = json.dumps(problem_schema(), indent=1)
    if output is None:
        typer.echo(text)
    else:
        check_output(output, "-o", (".json",))
        replace_text(output, f"{text}\n")
