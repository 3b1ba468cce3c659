"""Tables 3 and 4 of [Manara2017]_, and the lattice summed up in one table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from mbocp.study import Spread
from mbocp_papers.layout import Column, PaperTable, Section
from mbocp_papers.numbers import check_number
from mbocp_papers.so3 import counts, timings
from mbocp_papers.so3.counts import nodes_table
from mbocp_papers.so3.outcomes import ENDS, Outcomes, Runs
from mbocp_papers.so3.request import Request, Say
from mbocp_papers.so3.timings import timing_table

TITLES: Mapping[int, str] = {3: counts.TITLE, 4: timings.TITLE}


_SUMMARY = (
    Column("formulation", "", "label"),
    Column("tasks", "", "label"),
    Column("success", ""),
    Column("half-turns", ""),
    Column("not converged", ""),
    Column("iterations", ""),
    Column("ms/iteration", ""),
    Column("time/task [s]", ""),
    Column("cost", ""),
    Column("cost", "common tasks"),
)


def check_table(number: int) -> None:
    """Refuse a number that no table has.

    Raises
    ------
    InvalidValue
    """
    check_number("--table", number, TITLES)


def make_table(number: int, request: Request, say: Say = str) -> PaperTable:
    """Measure and lay out a table."""
    check_table(number)
    return nodes_table() if number == 3 else timing_table(request, say)


def summary_table(outcomes: Outcomes) -> PaperTable:
    """All that Figures 4, 8, 10 and 11 show, in numbers."""
    rows = tuple((_row(runs, outcomes),) for runs in outcomes.runs)
    failures = {runs.label: dict(runs.failures) for runs in outcomes.runs if runs.failures}
    notes = [
        f"{outcomes.words}. Success: converged with the pendulum upright within 1e-6 rad; numbers are mean ± "
        "standard deviation over the successes, times are the solver's alone.",
        f"common tasks: the {len(outcomes.common)} in which every formulation succeeds.",
    ]
    if failures:
        said = "; ".join(
            f"{label}: {', '.join(f'{status} {count}' for status, count in counts.items())}"
            for label, counts in failures.items()
        )
        notes.append(f"Not converged: {said}.")
    return PaperTable(
        number=None,
        title="The lattice by six formulations",
        columns=_SUMMARY,
        sections=(Section("", rows),),
        notes=tuple(notes),
        data=_data(outcomes),
    )


def spread_words(spread: Spread, digits: int) -> str:
    """Mean ± standard deviation."""
    if math.isnan(spread.mean):
        return "-"
    if math.isnan(spread.deviation):
        return f"{spread.mean:.{digits}f}"
    return f"{spread.mean:.{digits}f} ± {spread.deviation:.{digits}f}"


def _row(runs: Runs, outcomes: Outcomes) -> tuple[str, ...]:
    counts = runs.counts
    return (
        runs.label,
        str(len(runs.ends)),
        f"{100 * runs.success_rate:.1f} %",
        str(counts["half-turn"] + counts["elsewhere"]),
        str(counts["not converged"]),
        spread_words(runs.spread("iterations"), 1),
        spread_words(runs.spread("milliseconds"), 2),
        spread_words(runs.spread("seconds"), 3),
        spread_words(runs.spread("cost"), 3),
        spread_words(runs.spread("cost", outcomes.common), 3),
    )


def _data(outcomes: Outcomes) -> dict[str, Any]:
    return {
        "tasks": outcomes.num_tasks,
        "solver": outcomes.solver,
        "variant": outcomes.variant,
        "common_tasks": len(outcomes.common),
        "formulations": {runs.label: _numbers(runs, outcomes) for runs in outcomes.runs},
    }


def _numbers(runs: Runs, outcomes: Outcomes) -> Mapping[str, Any]:
    return {
        "tasks": len(runs.ends),
        "ends": {end: runs.counts[end] for end in ENDS},
        "failures": dict(runs.failures),
        "success_rate": runs.success_rate,
        **{name: runs.spread(name).to_dict() for name in ("iterations", "milliseconds", "seconds", "cost")},
        "cost_common": runs.spread("cost", outcomes.common).to_dict(),
    }
