"""Tables 2, 4, 6, 7: the four strategies at four step sizes, beside the paper's numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from mbocp_papers.layout import Column, PaperTable, Section, milliseconds, ratio
from mbocp_papers.pendulums.cases import SYSTEMS, Form
from mbocp_papers.pendulums.data import Comparison, Printed, PrintedRow, Strategy
from mbocp_papers.pendulums.measure import Run, run_strategy

COLUMNS = (
    Column("dt [s]", "", "label"),
    Column("DOF", "paper", "paper"),
    Column("DOF", "mbocp", "mbocp"),
    Column("strategy", "", "label"),
    Column("iterations", "paper", "paper"),
    Column("iterations", "none", "mbocp"),
    Column("iterations", "default", "mbocp"),
    Column("CPU time", "paper", "paper"),
    Column("CPU time", "none", "mbocp"),
    Column("CPU time", "default", "mbocp"),
    Column("ratio", "paper/none", "ratio"),
)
_FORMS = {
    "lagrange": "exact end condition (gamma = 1)",
    "penalty": "penalty form (gamma = 0, beta_T = 1, alpha = 1e-3)",
    "tracking": "no end condition, the bob's height is tracked",
}
_NOTES = (
    "none, default: solver.globalisation. none: the paper's algorithms, with backtracking in FBSM-Newton "
    "only; default: with mbocp's safeguards.",
    "paper: CPU time on its authors' machine, Jacobians by finite differences; mbocp: solver phases alone, "
    "medians, functions compiled before.",
)


@dataclass
class _Remarks:
    """Footnotes of a section, each said once."""

    texts: list[str] = field(default_factory=list)

    def mark(self, text: str) -> str:
        if text not in self.texts:
            self.texts.append(text)
        return " " + "abcdefghijklmnopqrstuvwxyz"[self.texts.index(text) % 26]

    def lines(self) -> tuple[str, ...]:
        return tuple(f"{'abcdefghijklmnopqrstuvwxyz'[i % 26]}: {text}" for i, text in enumerate(self.texts))


@dataclass(frozen=True)
class _Measured:
    """A strategy at a step size, with both globalisations, and what the paper prints of it."""

    strategy: Strategy
    paper: Printed | None
    none: Run
    default: Run


def comparison_table(
    comparison: Comparison, repetitions: int, most_rows: int | None, say: Callable[[str], object]
) -> PaperTable:
    """Measure all strategies at all step sizes (or at the `most_rows` coarsest)."""
    system, sections, data = SYSTEMS[comparison.system], [], {}
    for number, form in enumerate(system.forms):
        remarks, blocks, entries, costs = _Remarks(), [], [], []
        for row in comparison.rows[:most_rows]:
            say(f"Table {comparison.number}, {_FORMS[form].partition(' (')[0]}, dt = {row.dt:g} s")
            is_printed = number == 0  # the paper prints one form of each table
            measured = [
                _measure(comparison, form, row.steps, strategy, printed if is_printed else None, repetitions)
                for strategy, printed in row.measured_strategies()
            ]
            reference = measured[0].default
            blocks.append(_block(row, measured, reference, remarks))
            entries.append(_entry(row, measured, is_printed))
            costs.append(f"{reference.cost:.9g}")
        found = f"J = {', '.join(costs)}, found by all that converge and bear no mark"
        sections.append(
            Section(f"Section {system.section}, {_FORMS[form]}", blocks, (*remarks.lines(), found))
        )
        data[form] = entries
    return PaperTable(
        comparison.number,
        comparison.title,
        COLUMNS,
        tuple(sections),
        _NOTES,
        {"number": comparison.number, "title": comparison.title, "system": system.name, "forms": data},
    )


def _measure(
    comparison: Comparison,
    form: Form,
    steps: int,
    strategy: Strategy,
    paper: Printed | None,
    repetitions: int,
) -> _Measured:
    runs = [
        run_strategy(
            comparison.system,
            form,
            steps,
            strategy,
            globalisation=globalisation,
            gradient_iterations=comparison.gradient_iterations,
            repetitions=repetitions,
        )
        for globalisation in ("none", "default")
    ]
    return _Measured(strategy, paper, *runs)


def _block(
    row: PrintedRow, measured: list[_Measured], reference: Run, remarks: _Remarks
) -> list[tuple[str, ...]]:
    """Return the lines of one step size, one for each strategy."""
    lines: list[tuple[str, ...]] = []
    unknowns = str(reference.solution.unknowns) if reference.solution is not None else "-"
    dof = str(row.dof) if measured[0].paper else "-"
    for m in measured:
        gain, chosen = _gain(m)
        mark = remarks.mark("ratio with default: none does not converge") if chosen is m.default else ""
        lines.append(
            (
                *((f"{row.dt:g}", dof, unknowns) if not lines else ("", "", "")),
                m.strategy.label,
                "+".join(map(str, m.paper.iterations)) if m.paper else "-",
                _count(m.none, reference, remarks),
                _count(m.default, reference, remarks),
                f"{m.paper.seconds:g} s" if m.paper else "-",
                milliseconds(m.none.seconds) if m.none.converged else "-",
                milliseconds(m.default.seconds) if m.default.converged else "-",
                ratio(gain) + mark,
            )
        )
    return lines


def _gain(m: _Measured) -> tuple[float, Run | None]:
    """Ratio of the CPU times, and the run that it is about if it is not that of the paper's algorithm."""
    if m.paper is None or not (m.none.converged or m.default.converged):
        return math.nan, None
    run = m.none if m.none.converged else m.default
    return m.paper.seconds / run.seconds, run


def _count(run: Run, reference: Run, remarks: _Remarks) -> str:
    """Iterations; or how the run failed; with a mark where it found something else than the reference."""
    if not run.converged:
        words = f"{run.status} after {run.count} iterations" if run.solution is not None else run.advice
        return f"no ({run.status})" + (remarks.mark(words) if run.solution is None else "")
    if reference.converged and not run.agrees_with(reference):
        kind = "another local minimum" if run.is_minimum else "a stationary point, no minimum"
        return run.count + remarks.mark(f"{kind}: J = {run.cost:.6g}")
    return run.count


def _entry(row: PrintedRow, measured: list[_Measured], is_printed: bool) -> dict[str, Any]:
    strategies: dict[str, Any] = {}
    for m in measured:
        suffix = "" if m.strategy.adjoint == "direct" else f", {m.strategy.adjoint}"
        strategies[m.strategy.method + suffix] = {
            "paper": m.paper and {"iterations": list(m.paper.iterations), "seconds": m.paper.seconds},
            "none": m.none.to_dict(),
            "default": m.default.to_dict(),
        }
    solution = measured[0].default.solution
    return {
        "dt": row.dt,
        "steps": row.steps,
        "dof": row.dof if is_printed else None,
        "unknowns": solution.unknowns if solution is not None else None,
        "strategies": strategies,
    }
