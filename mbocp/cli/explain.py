"""`mbocp explain` and `bound`: why a problem has no solution, and what none can be better than."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from mbocp.cli import signals
from mbocp.cli.app import Json, ProblemOrResult, Quiet, Settings, switch
from mbocp.cli.solve import problem_and_solution

if TYPE_CHECKING:
    from mbocp.explaining import Explanation


_MAX_CAUSES = 6
_OR = "or"


def explain(
    file: ProblemOrResult,
    settings: Settings = None,
    search: Annotated[
        bool, switch("--search/--no-search", "Solve with wider limits, to see which is in the way.")
    ] = True,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Say why a problem cannot be solved.

    First what arithmetic tells; if that proves nothing, which limit has to give.
    """
    from mbocp import explaining

    signals.leave_in_order()
    problem, solution = problem_and_solution(file, settings or ())
    status = "" if solution is None else f"{solution.status}: {solution.advice}"

    def tell(words: str) -> None:
        if not (quiet or as_json):
            typer.echo(f"trying {words} ...", err=True)

    found = explaining.explain(problem, search=search, tell=tell)
    if as_json:
        typer.echo(json.dumps(_facts(found), indent=2))
    else:
        _print(problem.name, status, found, searched=search)


def _print(name: str, status: str, found: Explanation, *, searched: bool) -> None:
    from mbocp.cli.solution_summary import cause_rows, print_rows

    rows: list[tuple[str, str | Text]] = [("status", status)] if status else []
    rows += cause_rows(found.causes[:_MAX_CAUSES])
    if found.is_solvable:
        rows.append(("solvable", "Newton's method solves it as it is, within a hundred and fifty iterations"))
    for k, given in enumerate(found.given):
        rows.append((given.kind if k == 0 else f"{_OR} {given.kind}", given.words))
    if found.words:
        rows.append(("unknown", found.words))
    if not rows:
        more = (
            ""
            if searched
            else "; without --no-search it is solved with wider limits, to see which is in the way"
        )
        rows.append(("nothing", f"no arithmetic says that it cannot be solved{more}"))
    print_rows(name, rows)


def _facts(found: Explanation) -> dict[str, object]:
    return {
        "causes": [
            {"kind": c.kind, "where": c.where, "words": c.words, "certain": c.is_certain}
            for c in found.causes
        ],
        "solvable": found.is_solvable or None,
        "relaxations": [
            {"kind": g.kind, "factor": g.factor if g.factor < float("inf") else None, "words": g.words}
            for g in found.given
        ],
        "words": found.words,
    }


def bound(file: ProblemOrResult, settings: Settings = None, as_json: Json = False) -> None:
    """Bound cost and duration of all motions from below.

    Nothing is solved. A result is compared with it.
    """
    from mbocp._arrays import plain_json
    from mbocp.bounds import of_problem

    signals.leave_in_order()
    problem, solution = problem_and_solution(file, settings or ())
    found = of_problem.bound(problem, solution)
    if as_json:
        typer.echo(json.dumps(plain_json({**asdict(found), "gap": found.gap}), indent=2))
        return
    from mbocp.cli.solution_summary import print_rows

    rows = [("cost", found.words), ("duration", f"{found.duration:.6g} s at least")]
    print_rows(problem.name, [*rows, *([("of", f"the {found.of} problem")] if found.is_valid else [])])
