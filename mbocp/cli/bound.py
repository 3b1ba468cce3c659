"""`mbocp bound`: what no motion of a problem can be better than."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import typer

from mbocp._arrays import plain_json
from mbocp.cli import signals
from mbocp.cli.solve import problem_and_solution


def print_bound(file: Path, settings: Sequence[str], *, as_json: bool) -> None:
    """Print the bounds of a problem file, or of a result beside what it reached."""
    from mbocp.bounds.of_problem import bound

    signals.leave_in_order()
    problem, solution = problem_and_solution(file, settings)
    found = bound(problem, solution)
    if as_json:
        typer.echo(json.dumps(plain_json({**asdict(found), "gap": found.gap}), indent=2))
        return
    from mbocp.cli.summary import print_rows

    rows = [("cost", found.words), ("duration", f"{found.duration:.6g} s at least")]
    print_rows(problem.name, [*rows, *([("of", f"the {found.of} problem")] if found.is_valid else [])])
