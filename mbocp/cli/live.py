"""`mbocp live`: a problem on a page where its goal is dragged, and which solves it again meanwhile."""

from __future__ import annotations

import contextlib
import webbrowser
from collections.abc import Sequence
from pathlib import Path

import typer

from mbocp._files import RESULT_SUFFIXES
from mbocp.cli import signals
from mbocp.cli.solve import check_output, problem_of


def live_page(
    file: Path,
    settings: Sequence[str],
    output: Path | None,
    *,
    host: str,
    port: int,
    browser: bool,
    quiet: bool,
) -> None:
    """Serve the page until Ctrl-C; write the last motion that converged."""
    if output is not None:
        check_output(output, "-o", RESULT_SUFFIXES)
    import mbocp
    from mbocp.cli.progress import Progress
    from mbocp.interactive import Live
    from mbocp.view.live.scene import viser_module

    viser_module()  # before anything takes time
    signals.leave_in_order()
    with Progress(title=file.stem, quiet=quiet) as progress:
        problem = problem_of(file, settings)
        progress.say("compiling, then guessing (slow the first time)")
        solution = mbocp.solve(problem, callback=progress)
    with Live(problem, solution, host=host, port=port) as page:
        typer.echo(f"{problem.name}: open {page.url} in a browser (Ctrl-C ends it)")
        try:
            if browser:
                with contextlib.suppress(webbrowser.Error):
                    webbrowser.open(page.url, new=2)
            page.wait_until_closed()
        except KeyboardInterrupt:
            if not quiet:
                typer.echo("\nPage closed.")
        if output is not None:
            page.solution.save(output)
            if not quiet:
                typer.echo(f"result: {output}")
