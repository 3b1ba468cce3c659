"""`mbocp menu`: the local optima of a problem, as a table."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import typer

from mbocp._files import is_folder
from mbocp.cli import signals
from mbocp.cli.console import count, output, plain_table
from mbocp.cli.progress_table import Progress
from mbocp.cli.results import tell
from mbocp.cli.solve import PAGES, check_output, problem_of
from mbocp.exceptions import ResultFileError
from mbocp.menus.menu import Menu


def print_menu(
    file: Path,
    settings: Sequence[str],
    tries: int,
    folder: Path | None,
    replay: Path | None,
    *,
    as_json: bool,
    quiet: bool,
) -> int:
    """Print a menu, write what is asked for, and return the exit status."""
    if replay is not None:
        check_output(replay, "--replay", PAGES)
    if folder is not None and folder.exists() and not is_folder(folder):
        raise ResultFileError(folder, "-o is a file, expected the name of a folder")
    import mbocp

    signals.leave_in_order()
    with Progress(title=file.stem, quiet=quiet or as_json) as progress:
        progress.say("loading the robot")
        problem = problem_of(file, settings)
        progress.say(f"trying {count(tries, 'way')}")
        found = mbocp.menu(problem, tries=tries)
    files = found.save(folder) if folder is not None else []
    page = found.replay(replay) if replay is not None else None
    if as_json:
        typer.echo(json.dumps(_facts(found, files), indent=2))
    else:
        if not quiet:
            _print_table(found)
        for name, written in (("results", folder), ("replay", page)):
            if written is not None:
                tell(f"{name}: {written}", quiet)
    if not found.converged:
        typer.echo(f"{file.name}: none of {found.tried} ways leads to a motion: {found[0].advice}", err=True)
    return 0 if found.converged else 1


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
    console.print(
        f"\n{count(len(menu), 'motion')} from {count(menu.tried, 'way')} in {menu.wall_time_s:.2g} s"
    )
