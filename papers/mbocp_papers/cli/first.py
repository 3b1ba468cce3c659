"""`mbocp paper`: the first paper's tables beside mbocp's numbers, and its figures."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.text import Text

from mbocp.cli.console import output
from mbocp.exceptions import InvalidValue, MbocpError, ResultFileError

PAPERS = ("first", "so3")


def is_second(which: str) -> bool:
    """Which paper is meant by the word after --paper."""
    if which not in PAPERS:
        raise InvalidValue("--paper", which, f"one of {', '.join(PAPERS)}")
    return which == "so3"


def refuse(option: str | None) -> None:
    """Refuse an option that only the second paper has."""
    if option is not None:
        raise MbocpError(f"{option} belongs to the second paper; add --paper so3")


def everything() -> tuple[list[int], list[int]]:
    """Numbers of all tables and figures."""
    from mbocp_papers.pendulums.figures import FIGURES
    from mbocp_papers.pendulums.tables import TITLES

    return list(TITLES), list(FIGURES)


def print_overview() -> None:
    """Say which tables and figures there are."""
    from mbocp_papers.pendulums.figures import FIGURES
    from mbocp_papers.pendulums.tables import TITLES

    console = output()
    for option, titles in (
        ("--table", TITLES),
        ("--figure", {number: spec.title for number, spec in FIGURES.items()}),
    ):
        for number, title in titles.items():
            console.print(Text.assemble((f"{option} {number}", "bold"), f"  {title}"))
    console.print("Give numbers, each option as often as you like, or --all.", style="dim")
    console.print("The second paper: --paper so3", style="dim")


def reproduce(
    tables: Sequence[int],
    figures: Sequence[int],
    folder: Path,
    *,
    pdf: bool,
    quick: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Measure and print tables, draw and write figures, in the order that they are asked for.

    All numbers and the folder are checked before any work is done.
    """
    from mbocp_papers.machine import machine_line
    from mbocp_papers.pendulums.figures import check_figure, write_figure
    from mbocp_papers.pendulums.tables import check_table, make_table

    for number in tables:
        check_table(number)
    for number in figures:
        check_figure(number)
    if figures:
        check_folder(folder)
    found: dict[str, Any] = {"machine": machine_line(), "tables": {}, "figures": {}}
    console, shown = output(), not (as_json or quiet)
    if shown:
        console.print(Text(found["machine"], style="dim"), soft_wrap=True)
        console.print()
    for number in dict.fromkeys(tables):
        with progress(quiet=not shown) as say:
            table = make_table(number, quick=quick, say=say)
        found["tables"][str(number)] = table.data
        if shown:
            table.print(console)
    for number in dict.fromkeys(figures):
        with progress(quiet=not shown) as say:
            paths = write_figure(number, folder, suffixes=(".png", ".pdf") if pdf else (".png",), say=say)
        found["figures"][str(number)] = [str(path) for path in paths]
        if shown:
            console.print(f"figure {number}: {', '.join(map(str, paths))}", soft_wrap=True)
    if as_json:
        typer.echo(json.dumps(found, indent=2, allow_nan=False))


def check_folder(folder: Path) -> None:
    """Refuse, before any work is done, a folder that cannot be written to."""
    if folder.exists() and not folder.is_dir():
        raise ResultFileError(folder, "--output is a file, expected the name of a folder")
    parent = next(p for p in (folder, *folder.resolve().parents) if p.exists())
    if not os.access(parent, os.W_OK):
        raise ResultFileError(folder, "--output: no permission to write there")


@contextmanager
def progress(*, quiet: bool) -> Iterator[Callable[[str], object]]:
    """Say on stderr what is being worked on: on a terminal in one line that goes away."""
    console = Console(file=sys.stderr)
    if quiet:
        yield str
    elif console.is_terminal:
        with console.status("") as status:
            yield status.update
    else:
        yield lambda words: typer.echo(words, err=True)
