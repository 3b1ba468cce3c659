"""Tables 1, 3, 5: norms over the iterations, beside the paper's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mbocp.exceptions import MbocpError
from mbocp.paper.cases import SYSTEMS, paper_problem, strategy_settings
from mbocp.paper.data import STRATEGIES, Convergence, Strategy
from mbocp.paper.layout import Column, PaperTable, Section, norm
from mbocp.paper.measure import Run, finite, run_strategy
from mbocp.paper.norms import newton_norms

__all__ = ["convergence_table"]

_Norms = Mapping[int, tuple[float, float]]  # iteration -> (increment, residual)

COLUMNS = (
    Column("iteration", "", "label"),
    Column("Monolithic", "‖Δw‖ paper", "paper"),
    Column("Monolithic", "‖Δw‖ mbocp", "mbocp"),
    Column("Monolithic", "‖r_w‖ paper", "paper"),
    Column("Monolithic", "‖r_w‖ mbocp", "mbocp"),
    Column("FBSM-Newton", "‖Δω‖ paper", "paper"),
    Column("FBSM-Newton", "‖Δω‖ mbocp", "mbocp"),
    Column("FBSM-Newton", "‖r_u‖ paper", "paper"),
    Column("FBSM-Newton", "‖r_u‖ mbocp", "mbocp"),
)
_SCALED = (
    "Norms as in the paper, as its first iteration in Table 1 tells: mu_N and u_N are among the unknowns, "
    "state and adjoint rows of r_w are divided by dt."
)
_REMARKS = {
    3: "Penalty form, after 500 iterations of FBSM-BB, whose path depends on what the paper leaves open; "
    "omega without u_N.",
    5: "The paper prints neither its adjoint guess nor l_o: the norms cannot be the same.",
}


def convergence_table(convergence: Convergence, say: Callable[[str], object]) -> PaperTable:
    """Lay out the histories of both Newton methods, without globalisation as in the paper."""
    say(f"Table {convergence.number}")
    pair = STRATEGIES[2:] if convergence.gradient_iterations else STRATEGIES[:2]
    runs = [_run(convergence, strategy) for strategy in pair]
    histories = [_history(convergence, strategy) for strategy in pair]
    shown = {step.iteration: (step.monolithic, step.fbsm_newton) for step in convergence.printed}
    for history in histories:
        if history:
            shown.setdefault(max(history), (None, None))
    rows, entries = [], []
    for k in sorted(shown):
        cells: list[tuple[float, float] | None] = []
        for paper, history in zip(shown[k], histories, strict=True):
            cells += [paper, history.get(k)]
        rows.append((str(k), *_columns(cells)))
        entries.append(_entry(k, cells))
    outcomes = [_outcome(s, run) for s, run in zip(pair, runs, strict=True)]
    remarks = [_REMARKS[convergence.number]] if convergence.number in _REMARKS else []
    system = SYSTEMS[convergence.system]
    return PaperTable(
        convergence.number,
        f"{convergence.title} (dt = 0.01 s)",
        COLUMNS,
        (Section(f"Section {system.section}", [rows], (*outcomes, *remarks)),),
        (_SCALED,),
        {
            "number": convergence.number,
            "title": convergence.title,
            "system": system.name,
            "rows": entries,
            "runs": {s.method: run.to_dict() for s, run in zip(pair, runs, strict=True)},
        },
    )


def _run(convergence: Convergence, strategy: Strategy) -> Run:
    form = SYSTEMS[convergence.system].forms[0]
    return run_strategy(
        convergence.system,
        form,
        convergence.steps,
        strategy,
        globalisation="none",
        gradient_iterations=convergence.gradient_iterations,
    )


def _history(convergence: Convergence, strategy: Strategy) -> _Norms:
    """Norms in the paper's scaling; none where mbocp refuses the problem, which the run itself reports."""
    form = SYSTEMS[convergence.system].forms[0]
    settings = strategy_settings(strategy, "none", convergence.gradient_iterations or 25)
    try:
        problem = paper_problem(convergence.system, form, convergence.steps, settings)
        return {n.iteration: (n.increment, n.residual) for n in newton_norms(problem)}
    except MbocpError:
        return {}


def _columns(cells: list[tuple[float, float] | None]) -> list[str]:
    """Order as the columns are: paper's and mbocp's increment, paper's and mbocp's residual."""
    texts = []
    for paper, ours in (cells[:2], cells[2:]):
        for i in (0, 1):
            texts += [norm(paper and paper[i]), norm(ours and ours[i])]
    return texts


def _entry(iteration: int, cells: list[tuple[float, float] | None]) -> dict[str, Any]:
    names = ("monolithic", "fbsm_newton")
    entry: dict[str, Any] = {"iteration": iteration}
    for name, paper, ours in zip(names, cells[::2], cells[1::2], strict=True):
        entry[name] = {"paper": paper and list(paper), "mbocp": ours and [finite(value) for value in ours]}
    return entry


def _outcome(strategy: Strategy, run: Run) -> str:
    if run.solution is None:
        return f"{strategy.label}: no ({run.status}): {run.advice}"
    verdict = "converged" if run.converged else f"no ({run.status})"
    return f"{strategy.label}: {verdict} after {run.count} iterations, J = {run.cost:.9g}"
