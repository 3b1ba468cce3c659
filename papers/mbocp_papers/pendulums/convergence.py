"""Tables 1, 3, 5: norms over the iterations, beside the paper's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mbocp.exceptions import MbocpError
from mbocp.solution import Status
from mbocp_papers.layout import Column, PaperTable, Section, norm
from mbocp_papers.pendulums.cases import SYSTEMS, paper_problem, strategy_settings
from mbocp_papers.pendulums.data import STRATEGIES, Convergence, Strategy
from mbocp_papers.pendulums.measure import finite
from mbocp_papers.pendulums.norms import History, newton_history

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
    found = [_history(convergence, strategy) for strategy in pair]
    histories = [_norms(history) for history in found]
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
    outcomes = [_outcome(strategy, history) for strategy, history in zip(pair, found, strict=True)]
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
            "runs": {s.method: _summary(history) for s, history in zip(pair, found, strict=True)},
        },
    )


def _history(convergence: Convergence, strategy: Strategy) -> History | MbocpError:
    """Norms in the paper's scaling; or the error with which mbocp refuses the problem."""
    form = SYSTEMS[convergence.system].forms[0]
    settings = strategy_settings(strategy, "none", convergence.gradient_iterations or 25)
    try:
        return newton_history(paper_problem(convergence.system, form, convergence.steps, settings))
    except MbocpError as error:
        return error


def _norms(history: History | MbocpError) -> _Norms:
    if isinstance(history, MbocpError):
        return {}
    return {n.iteration: (n.increment, n.residual) for n in history.norms}


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


def _outcome(strategy: Strategy, history: History | MbocpError) -> str:
    if isinstance(history, MbocpError):
        return f"{strategy.label}: no ({type(history).__name__}): {history}"
    verdict = "converged" if history.status is Status.CONVERGED else f"no ({history.status})"
    count = "+".join(map(str, history.iterations))
    return f"{strategy.label}: {verdict} after {count} iterations, J = {history.cost:.9g}"


def _summary(history: History | MbocpError) -> dict[str, Any]:
    if isinstance(history, MbocpError):
        return {"status": type(history).__name__, "iterations": [], "cost": None}
    return {
        "status": str(history.status),
        "iterations": list(history.iterations),
        "cost": finite(history.cost),
    }
