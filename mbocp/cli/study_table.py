"""`mbocp study`: run many problems, or sum up what came of them."""

from __future__ import annotations

import json
import math
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from mbocp._text import shorten
from mbocp.cli import signals
from mbocp.cli.app import Json, Quiet, argument, option, output_file
from mbocp.cli.console import output, plain_table
from mbocp.cli.error_report import INTERRUPTED
from mbocp.cli.solve import IMAGES, check_output
from mbocp.exceptions import ResultFileError, StudyError

if TYPE_CHECKING:
    from mbocp.study import Spread, StudyResult, Summary, TaskGroup

TABLES = (".jsonl", ".ndjson")
CSV = (".csv",)

_DECIMALS = 6  # beyond so many digits on either side of the point, powers of ten read better


@dataclass(frozen=True)
class How:
    """How a study is run."""

    workers: int | None = None
    scheduler: str | None = None
    resume: bool = False
    overwrite: bool = False


@dataclass(frozen=True)
class RowResults:
    """What is made of the rows."""

    by: tuple[str, ...] | None = None
    plot: Path | None = None
    csv: Path | None = None
    as_json: bool = False
    quiet: bool = False

    def check(self) -> None:
        """Refuse what could not be written, before any work is done."""
        if self.plot is not None:
            check_output(self.plot, "--plot", IMAGES)
        if self.csv is not None:
            check_output(self.csv, "--csv", CSV)


def study(
    file: Annotated[Path | None, argument("STUDY", "Study file (TOML).")] = None,
    output: Annotated[Path | None, output_file("FILE.jsonl", "Where the rows go.")] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Processes. [default: one a processor]")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help='Run on Dask: tcp://HOST:PORT, or "local" for a cluster here.'),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with FILE.jsonl, if it is there.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Begin FILE.jsonl anew.")] = False,
    summary: Annotated[
        Path | None, option("--summary", "FILE.jsonl", "Run nothing, sum up what is there.")
    ] = None,
    by: Annotated[
        list[str] | None, option("--by", "NAME", "Sum up by this varied key or axis. Repeatable.")
    ] = None,
    plot: Annotated[Path | None, option("--plot", "FILE.png", "Draw the summary as bars.")] = None,
    csv: Annotated[Path | None, option("--csv", "FILE.csv", "Write all rows.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Solve many problems: a grid, a random sample, or a list.

    Exit status: 0 all tasks converged, 1 some did not (each has a row), 2 bad input, 130 interrupted
    (--resume goes on).
    """
    if (file is None) == (summary is None):
        raise StudyError("give a study file to run or --summary FILE.jsonl to sum up, one of the two")
    shown = RowResults(by=tuple(by) if by else None, plot=plot, csv=csv, as_json=as_json, quiet=quiet)
    shown.check()
    from mbocp.study import StudyResult

    if summary is not None:
        _show(StudyResult.load(summary), summary, shown)
    elif file is not None:
        _run(file, output, How(workers, scheduler, resume, overwrite), shown)


def _run(file: Path, table: Path | None, how: How, shown: RowResults) -> None:
    """Run a study and sum it up; Ctrl-C ends with the command that goes on."""
    if table is None:
        raise StudyError("say with -o FILE.jsonl where the rows go")
    check_output(table, "-o", TABLES)
    from mbocp.study import Study, run_study

    signals.leave_in_order()
    study = Study.load(file)
    for name in shown.by or ():
        if name not in study.names:
            raise StudyError(f"--by {name}: is not varied; varied are {', '.join(study.names)}")
    try:
        with (
            _executor(how) as (executor, workers),
            _bar(study.name, quiet=shown.quiet or shown.as_json) as bar,
        ):
            result = run_study(
                study,
                table,
                executor=executor,
                workers=workers,
                resume=how.resume,
                overwrite=how.overwrite,
                progress=bar,
            )
    except KeyboardInterrupt:
        _say_how_to_go_on(file, table, how)
        raise typer.Exit(signals.status_of_signal() or INTERRUPTED) from None
    _show(result, table, shown)
    if result.not_converged:
        raise typer.Exit(1)


@contextmanager
def _executor(how: How) -> Iterator[tuple[Executor | None, int | None]]:
    if how.scheduler is None:
        yield None, how.workers
        return
    from mbocp.study.pools import dask_executor

    with dask_executor(how.scheduler, how.workers) as (executor, workers):
        yield executor, workers


@contextmanager
def _bar(title: str, *, quiet: bool) -> Iterator[Callable[[int, int], None]]:
    """Rows so far and the time that is left, on a terminal; nothing elsewhere."""
    console, begun = Console(file=sys.stderr), False
    rows = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    times = (TimeElapsedColumn(), TextColumn("left:"), TimeRemainingColumn())
    with Progress(
        *rows,
        *times,
        console=console,
        transient=True,
        disable=quiet or not console.is_terminal,
        speed_estimate_period=600.0,
    ) as progress:
        task = progress.add_task(f"{title}: compiling", total=None)

        def show(done: int, total: int) -> None:
            nonlocal begun
            if begun:
                progress.update(task, completed=done, description=title)
            else:  # what was there before says nothing about the speed
                progress.reset(task, total=total, completed=done)
                begun = True

        yield show


def _say_how_to_go_on(file: Path, table: Path, how: How) -> None:
    command = ["mbocp", "study", str(file), "-o", str(table), "--resume"]
    command += ["--workers", str(how.workers)] if how.workers is not None else []
    command += ["--scheduler", how.scheduler] if how.scheduler is not None else []
    try:
        from mbocp.study import StudyResult

        result = StudyResult.load(table)
        there = f"{len(result)} of {result.num_tasks} tasks are in {table}"
    except ResultFileError:  # it was too early for that
        there = "no task was done yet"
    typer.echo(f"interrupted: {there}; go on with\n  {shlex.join(command)}", err=True)


def _show(result: StudyResult, table: Path, shown: RowResults) -> None:
    """Print the summary and write what is asked for."""
    summary = result.summary(shown.by)
    written = []
    if shown.csv is not None:
        written.append(("csv", result.to_csv(shown.csv)))
    if shown.plot is not None:
        written.append(("plot", result.plot(shown.plot, shown.by)))
    if shown.as_json:
        facts: dict[str, Any] = {"name": result.name, "file": str(table), "tasks": result.num_tasks}
        facts |= {"done": len(result), "not_converged": result.not_converged, **summary.to_dict()}
        typer.echo(json.dumps(facts, indent=2, allow_nan=False))
    elif not shown.quiet:
        _print(result, summary, [("rows", table), *written])


def _print(result: StudyResult, summary: Summary, written: Sequence[tuple[str, Path]]) -> None:
    from mbocp.study.summary import word

    console = output()
    there = f"{len(result)} of {result.num_tasks} tasks" if not result.is_complete else f"{len(result)} tasks"
    console.print(Text.assemble((result.name, "bold underline"), f"  {there}"))
    console.print(_table(summary))
    notes = "mean ± standard deviation over the successes; times of the solver alone"
    if summary.goal_distance is not None:
        notes += f"; a success ends within {summary.goal_distance:g} of the goal"
    console.print(Text(notes, style="dim"))
    if ends := result.not_converged:
        words = ", ".join(f"{status} {count}" for status, count in ends.items())
        console.print(
            Text(f"{sum(ends.values())} of {len(result)} tasks did not converge: {words}", "yellow")
        )
    of_groups = {group.best for group in summary.groups}
    if bests := [row for row in result.rows if row["index"] in of_groups]:
        best = min(bests, key=lambda row: row["cost"])
        values = ", ".join(f"{name} = {word(value)}" for name, value in best["values"].items())
        found = f"task {best['index']}, cost {best['cost']:.6g}: {shorten(values)}"
        console.print(Text.assemble(("best  ", "bold"), found), soft_wrap=True)
    for kind, path in written:
        console.print(Text.assemble((f"{kind}  ", "bold"), str(path)), soft_wrap=True)


def _table(summary: Summary) -> Table:
    from mbocp.study.summary import word

    table = plain_table(header_style="bold")
    for name in summary.by:
        table.add_column(Text(name), no_wrap=True)
    for name in ("tasks", "success", "iterations", "time/task", "time/iteration", "cost"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("the others", overflow="fold")
    for group in summary.groups:
        table.add_row(*(Text(word(value)) for value in group.values), *_cells(group))
    return table


def _cells(group: TaskGroup) -> tuple[str, ...]:
    return (
        str(group.tasks),
        f"{100 * group.success_rate:.1f} %",
        _spread(group.iterations),
        _time(group.seconds),
        _time(group.seconds_per_iteration),
        _spread(group.cost),
        ", ".join(f"{status} {count}" for status, count in group.others.items()),
    )


def _time(seconds: Spread) -> str:
    from mbocp.study import Spread

    if seconds.mean >= 1.0:
        return f"{_spread(seconds)} s"
    scaled = _spread(Spread(1e3 * seconds.mean, 1e3 * seconds.deviation))
    return scaled if scaled == "-" else f"{scaled} ms"


def _spread(spread: Spread) -> str:
    """Mean and deviation to the deviation's second digit."""
    mean, deviation = spread.mean, spread.deviation
    if math.isnan(mean):
        return "-"
    if math.isnan(deviation) or deviation == 0.0:
        return f"{mean:.4g}" if math.isnan(deviation) else f"{mean:.4g} ± 0"
    decimals = 1 - math.floor(math.log10(deviation))
    if decimals > _DECIMALS or abs(mean) + deviation >= 10**_DECIMALS:
        return f"{mean:.4g} ± {deviation:.2g}"
    return f"{mean:.{max(decimals, 0)}f} ± {deviation:.{max(decimals, 0)}f}"
