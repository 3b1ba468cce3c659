"""`mbocp paper --paper so3`: the second paper's tables and figures."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.text import Text

from mbocp.cli.console import output
from mbocp.cli.error_report import INTERRUPTED
from mbocp.exceptions import ResultFileError
from mbocp_papers.cli.first import check_folder, progress

if TYPE_CHECKING:
    from mbocp_papers.so3.request import Request


@dataclass(frozen=True)
class Wanted:
    """What the command line says of the second paper alone; None where it says nothing."""

    lattice: str | None = None
    variant: str | None = None
    solver: str | None = None
    workers: int | None = None
    results: Path | None = None
    resume: bool = False

    def option(self) -> str | None:
        """Return an option that was given, if any was."""
        for name in ("lattice", "variant", "solver", "workers", "results", "resume"):
            if getattr(self, name):
                return f"--{name}"
        return None

    def request(self, folder: Path, *, quick: bool, pdf: bool) -> Request:
        """Check all of it."""
        from mbocp_papers.so3.experiment import Lattice, parse_lattice
        from mbocp_papers.so3.request import DEFAULT_SOLVERS, QUICK_LATTICE, Request

        default = QUICK_LATTICE if quick else Lattice()
        variant = self.variant or "corrected"
        return Request(
            folder=folder,
            lattice=parse_lattice(self.lattice) if self.lattice is not None else default,
            variant=variant,
            solver=self.solver or DEFAULT_SOLVERS.get(variant, "monolithic"),
            workers=self.workers,
            quick=quick,
            results=self.results,
            resume=self.resume,
            suffixes=(".png", ".pdf") if pdf else (".png",),
        )


def everything() -> tuple[list[int], list[int]]:
    """Numbers of all tables and figures."""
    from mbocp_papers.so3.figures import FIGURES
    from mbocp_papers.so3.tables import TITLES

    return list(TITLES), list(FIGURES)


def print_overview() -> None:
    """Say which tables and figures there are."""
    from mbocp_papers.so3.figures import FIGURES, LATTICE_FIGURES
    from mbocp_papers.so3.tables import TITLES

    console = output()
    for number, title in TITLES.items():
        console.print(Text.assemble((f"--table {number}", "bold"), f"  {title}"))
    for number, spec in FIGURES.items():
        star = " *" if number in LATTICE_FIGURES else ""
        console.print(Text.assemble((f"--figure {number}", "bold"), f"  {spec.title}{star}"))
    console.print(
        "Give numbers, each option as often as you like, or --all. *: from the rows of a lattice of tasks; "
        "--lattice 5x5x4 is a small one, --results FILE.jsonl takes rows that are there.",
        style="dim",
    )


def reproduce(
    tables: Sequence[int], figures: Sequence[int], request: Request, *, as_json: bool, quiet: bool
) -> None:
    """Make tables and figures in the order that they are asked for.

    All numbers and the folder are checked before any work is done. Ctrl-C while the lattice is solved ends
    with the options that go on.
    """
    from mbocp_papers.machine import machine_line
    from mbocp_papers.so3.figures import LATTICE_FIGURES, write_figure
    from mbocp_papers.so3.request import lattice_outcomes
    from mbocp_papers.so3.tables import make_table, summary_table

    _check(tables, figures, request)
    found: dict[str, Any] = {"machine": machine_line(), "tables": {}, "figures": {}}
    console, shown = output(), not (as_json or quiet)
    if shown:
        console.print(Text(found["machine"], style="dim"), soft_wrap=True)
        console.print()
    for number in dict.fromkeys(tables):
        with progress(quiet=not shown) as say:
            table = make_table(number, request, say)
        found["tables"][str(number)] = table.data
        if shown:
            table.print(console)
    if any(number in LATTICE_FIGURES for number in figures):
        try:
            with progress(quiet=not shown) as say:
                outcomes = lattice_outcomes(request, say)
        except KeyboardInterrupt:
            _say_how_to_go_on(request)
            raise typer.Exit(INTERRUPTED) from None
        summary = summary_table(outcomes)
        found["lattice"] = {"file": str(request.rows), **summary.data}
        if shown:
            summary.print(console)
            console.print(f"rows: {request.rows}", soft_wrap=True)
    for number in dict.fromkeys(figures):
        with progress(quiet=not shown) as say:
            paths = write_figure(number, request, say)
        found["figures"][str(number)] = [str(path) for path in paths]
        if shown:
            console.print(f"figure {number}: {', '.join(map(str, paths))}", soft_wrap=True)
    if as_json:
        typer.echo(json.dumps(found, indent=2, allow_nan=False))


def _check(tables: Sequence[int], figures: Sequence[int], request: Request) -> None:
    from mbocp_papers.so3.figures import check_figure
    from mbocp_papers.so3.tables import check_table

    for number in tables:
        check_table(number)
    for number in figures:
        check_figure(number)
    check_folder(request.folder)
    if request.results is not None and request.results.is_dir():
        raise ResultFileError(request.results, "--results is a folder, expected the name of a file")


def _say_how_to_go_on(request: Request) -> None:
    if not request.rows.exists():
        typer.echo("interrupted: no task was done yet", err=True)
        return
    typer.echo(
        f"interrupted: rows so far are in {request.rows}; the same command with --resume "
        f"--results {shlex.quote(str(request.rows))} goes on",
        err=True,
    )
