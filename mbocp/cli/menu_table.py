"""`mbocp menu`: the local optima of a problem, as a table."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbocp._files import is_folder
from mbocp.cli import signals
from mbocp.cli.app import Json, Quiet, Settings, argument, option, output_file
from mbocp.cli.console import count, output, plain_table
from mbocp.cli.progress_table import ProgressCallback
from mbocp.cli.results import tell
from mbocp.cli.solve import PAGES, check_output, problem_of
from mbocp.exceptions import ResultFileError

if TYPE_CHECKING:
    from mbocp.menus.menu import Menu


def menu(
    file: Annotated[Path, argument("FILE", "Problem file (TOML), or a result of a solve.")],
    settings: Settings = None,
    tries: Annotated[int, typer.Option(min=1, metavar="N", help="Ways to try, to each goal.")] = 24,
    output: Annotated[Path | None, output_file("FOLDER", "Save a result for each in this folder.")] = None,
    replay: Annotated[
        Path | None, option("--replay", "FILE.html", "Write a page with the first five at once.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """List different motions that solve a problem, the cheapest first.

    Exit status: 0 converged, 1 none converged, 2 bad input, 130 interrupted before there is any.
    """
    if replay is not None:
        check_output(replay, "--replay", PAGES)
    if output is not None and output.exists() and not is_folder(output):
        raise ResultFileError(output, "-o is a file, expected the name of a folder")
    from mbocp.menus import menu as menus

    signals.leave_in_order()
    with ProgressCallback(title=file.stem, quiet=quiet or as_json) as progress:
        progress.say("loading the robot")
        problem = problem_of(file, settings or ())
        progress.say(f"trying {count(tries, 'way')}")
        found = menus.menu(problem, tries=tries)
    files = found.save(output) if output is not None else []
    page = found.replay(replay) if replay is not None else None
    if as_json:
        typer.echo(json.dumps(_facts(found, files), indent=2))
    else:
        if not quiet:
            _print_table(found)
        for name, written in (("results", output), ("replay", page)):
            if written is not None:
                tell(f"{name}: {written}", quiet)
    if not found.converged:
        typer.echo(f"{file.name}: none of {found.tried} ways leads to a motion: {found[0].advice}", err=True)
    raise typer.Exit(0 if found.converged else 1)


def _facts(menu: Menu, files: Sequence[Path]) -> dict[str, object]:
    choices = [
        {
            "name": choice.name,
            "status": str(choice.solution.status),
            "cost": choice.solution.cost,
            "duration": float(choice.solution.t[-1]),
            "guess": choice.solution.guess_used,
            "ways": choice.ways,
            "file": str(files[place]) if files else None,
        }
        for place, choice in enumerate(menu.choices)
    ]
    return {"tried": menu.tried, "wall_time_s": menu.wall_time_s, "choices": choices}


def _print_table(menu: Menu) -> None:
    table, best = plain_table("", "motion", "cost", "of the best", r"duration \[s]", "ways"), menu[0]
    for place, choice in enumerate(menu.choices, start=1):
        solution = choice.solution
        share = f"{solution.cost / best.cost:.3g}" if best.cost > 0.0 else "-"
        numbers = (f"{solution.cost:.6g}", share, f"{solution.t[-1]:.4g}", str(choice.ways))
        table.add_row(str(place), choice.name, *numbers)
    console = output()
    console.print(table)
    tried = f"{count(menu.tried, 'way')} in {menu.wall_time_s:.2g} s"
    console.print(f"\n{count(len(menu), 'motion')} from {tried}")
