"""What `mbocp paper` takes; the work is imported when it is asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mbocp.cli import signals
from mbocp.cli.app import Json, Quiet
from mbocp.cli.command_examples import epilog
from mbocp.cli.error_report import report_errors_of

app = typer.Typer()
_EXAMPLES = ("mbocp paper --table 1", "mbocp paper --paper so3 --figure 3")


@app.command(epilog=epilog(_EXAMPLES))
@report_errors_of
def paper(
    which: Annotated[
        str,
        typer.Option(
            "--paper", metavar="NAME", help="first: solution strategies; so3: integration of rotations."
        ),
    ] = "first",
    table: Annotated[
        list[int] | None,
        typer.Option("--table", metavar="N", help="Table 1 to 7; so3: 3 or 4. Repeatable."),
    ] = None,
    figure: Annotated[
        list[int] | None,
        typer.Option("--figure", metavar="N", help="Figure 2, 3, 4, 6, 7 or 8; so3: 3 to 12. Repeatable."),
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="All tables and figures.")] = False,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the figures.")
    ] = Path("paper"),
    pdf: Annotated[bool, typer.Option("--pdf", help="Figures as PDF, too, besides PNG.")] = False,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Coarsest step sizes, solved once; so3: a lattice of 2x2x2, few steps."),
    ] = False,
    lattice: Annotated[
        str | None, typer.Option(metavar="NxNxM", help="so3: places and yaw angles. [default: 13x13x12]")
    ] = None,
    variant: Annotated[
        str | None, typer.Option(metavar="NAME", help="so3: corrected (default) or as_printed.")
    ] = None,
    solver: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="so3: monolithic, fatrop or ipopt. [default: monolithic, as_printed: ipopt]"
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="so3: processes. [default: one a processor]")
    ] = None,
    results: Annotated[
        Path | None,
        typer.Option(metavar="FILE.jsonl", help="so3: rows of the lattice; taken as they are, if there."),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="so3: go on with rows that are there.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Reproduce a paper: its tables beside mbocp's, and its figures.

    Without options, say what there is.
    """
    from mbocp_papers.cli import first, second

    signals.leave_in_order()
    wanted = second.Wanted(lattice, variant, solver, workers, results, resume)
    if first.is_second(which):
        request = wanted.request(output, quick=quick, pdf=pdf)
        tables, figures = second.everything() if everything else (table or [], figure or [])
        if tables or figures:
            second.reproduce(tables, figures, request, as_json=as_json, quiet=quiet)
        else:
            second.print_overview()
        return
    first.refuse(wanted.option())
    tables, figures = first.everything() if everything else (table or [], figure or [])
    if tables or figures:
        first.reproduce(tables, figures, output, pdf=pdf, quick=quick, as_json=as_json, quiet=quiet)
    else:
        first.print_overview()
