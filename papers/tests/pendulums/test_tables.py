"""Tables with the paper's numbers and mbocp's, on the coarsest steps."""

from __future__ import annotations

import io
import json
import math
from functools import cache

import pytest
from mbocp_papers.layout import WIDTH, milliseconds, ratio
from mbocp_papers.pendulums import convergence
from mbocp_papers.pendulums import measure as measuring
from mbocp_papers.pendulums.cases import paper_problem, strategy_settings
from mbocp_papers.pendulums.data import COMPARISONS, STRATEGIES
from mbocp_papers.pendulums.measure import run_strategy
from mbocp_papers.pendulums.norms import newton_history
from mbocp_papers.pendulums.tables import TITLES, make_table
from rich.console import Console

from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.solving import solve


def printed(table) -> str:
    console = Console(width=WIDTH, file=io.StringIO())
    table.print(console)
    return console.file.getvalue()  # type: ignore[attr-defined]


@cache
def quick_table(number: int):
    return make_table(number, quick=True)


@pytest.fixture(params=[c.number for c in COMPARISONS])
def comparison(request: pytest.FixtureRequest):
    return quick_table(request.param)


def test_comparison_has_the_paper_s_numbers(comparison) -> None:
    rows = next(c for c in COMPARISONS if c.number == comparison.number).rows[:2]
    text, markdown = printed(comparison), comparison.markdown()
    for row in rows:
        for strategy, paper in zip(STRATEGIES, row.printed, strict=True):
            for words in (text, markdown):
                assert strategy.label in words
                assert "+".join(map(str, paper.iterations)) in words
                assert f"{paper.seconds:g} s" in words
        assert str(row.dof) in text


def test_comparison_fits_the_width(comparison) -> None:
    assert all(len(line.rstrip()) <= WIDTH for line in printed(comparison).splitlines())
    assert "…" not in printed(comparison)  # nothing cut off


def test_comparison_measures_every_strategy(comparison) -> None:
    data = json.loads(json.dumps(comparison.data, allow_nan=False))
    for rows in data["forms"].values():
        assert len(rows) == 2
        for row in rows:
            assert set(row["strategies"]) == {s.method for s in STRATEGIES}
            assert all(m["default"]["status"] == "converged" for m in row["strategies"].values())
            assert row["strategies"]["monolithic"]["default"]["is_minimum"]
            for method, found in row["strategies"].items():
                if "+" in method:
                    assert len(found["default"]["iterations"]) == 2


def test_all_strategies_find_the_same_optimum_of_the_elastic_pendulum() -> None:
    (rows,) = quick_table(2).data["forms"].values()
    for row in rows:
        costs = [m[g]["cost"] for m in row["strategies"].values() for g in ("none", "default")]
        assert costs == pytest.approx([costs[0]] * 8, rel=1e-8)


def test_first_iteration_of_table_1_is_met_to_all_digits() -> None:
    """In the paper's unknowns and scaling; from the second digits on only with a = 9.8 m/s^2."""
    data = make_table(1).data
    first = data["rows"][0]
    assert first["iteration"] == 1
    paper, ours = first["monolithic"]["paper"], first["monolithic"]["mbocp"]
    assert ours == pytest.approx(paper, rel=2e-7)
    assert data["runs"]["monolithic"]["iterations"] == [15]


def test_norms_of_the_paper_converge_quadratically() -> None:
    problem = paper_problem("elastic_pendulum", "lagrange", 50, {"solver.method": "monolithic"})
    norms = newton_history(problem).norms
    assert norms[-1].residual < 1e-9
    assert norms[-2].increment < 10 * norms[-3].increment ** 1.6


def test_a_history_that_is_refused_is_shown_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    def refusing(problem):
        raise ProblemError(f"no {problem.solver.method}")

    monkeypatch.setattr(convergence, "newton_history", refusing)
    table = make_table(1)
    assert "FBSM-Newton: no (ProblemError): no fbsm_newton" in printed(table)
    assert table.data["runs"]["monolithic"] == {"status": "ProblemError", "iterations": [], "cost": None}


def test_histories_agree_with_solve() -> None:
    """They drive the solvers themselves: the end must be the same."""
    settings = strategy_settings(STRATEGIES[3], "none", 25)
    problem = paper_problem("cart_pendulum_rigid", "tracking", 20, settings)
    history, solution = newton_history(problem), solve(problem)
    assert str(history.status) == str(solution.status)
    assert history.iterations == tuple(p.iterations for p in solution.phases if p.iterations)
    assert history.cost == pytest.approx(solution.cost, rel=1e-12)


@pytest.mark.parametrize("number", [3, 5])
def test_histories_of_the_constrained_pendulums(number: int) -> None:
    table = make_table(number)
    text = printed(table)
    assert "paper" in text
    assert "…" not in text
    json.dumps(table.data, allow_nan=False)
    assert {row["iteration"] for row in table.data["rows"]} >= {1, 4, 5, 6}
    for row in table.data["rows"]:
        for name in ("monolithic", "fbsm_newton"):
            assert row[name]["mbocp"] is None or all(v is None or v >= 0.0 for v in row[name]["mbocp"])


def test_a_strategy_that_fails_is_shown_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that does not converge, and one that mbocp refuses."""
    honest = measuring.solve

    def failing(problem):
        if problem.solver.method == "fbsm_newton":
            raise ProblemError("guess: the forward simulation fails")
        if problem.solver.method == "fbsm_bb+monolithic":
            return honest(problem.with_(solver=type(problem.solver)(max_iterations=1, method="monolithic")))
        return honest(problem)

    monkeypatch.setattr(measuring, "solve", failing)
    text = printed(make_table(7, quick=True))
    assert "no (ProblemError)" in text
    assert "the forward simulation fails" in text
    assert "no (max_iterations)" in text


def test_an_interruption_ends_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """`solve` returns its best iterate then, which is no reason to go on to the next strategy."""

    def interrupted(problem):
        def press(_record):
            raise KeyboardInterrupt

        return solve(problem, callback=press)

    monkeypatch.setattr(measuring, "solve", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make_table(2, quick=True)


def test_pure_newton_on_the_elastic_cart_fails_honestly() -> None:
    """From zero adjoints, at a small step."""
    run = run_strategy("cart_pendulum_elastic", "tracking", 200, STRATEGIES[0], globalisation="none")
    assert not run.converged
    assert run.solution is not None
    assert math.isfinite(run.seconds)


def test_unknown_tables_are_refused() -> None:
    assert list(TITLES) == [1, 2, 3, 4, 5, 6, 7]
    with pytest.raises(InvalidValue, match="--table: got 8, expected one of 1, 2"):
        make_table(8)


def test_formats() -> None:
    assert milliseconds(0.00123) == "1.23 ms"
    assert milliseconds(0.123) == "123 ms"
    assert milliseconds(1.5) == "1.50 s"
    assert milliseconds(math.nan) == "-"
    assert ratio(192966.0) == "193,000"
    assert ratio(3.14) == "3.1"


@pytest.mark.parametrize("width", [80, 100])
def test_a_narrow_terminal_gets_columns_below_each_other_and_no_cut_cells(comparison, width: int) -> None:
    console = Console(width=width, file=io.StringIO())
    comparison.print(console)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width
    words = text.split()
    for section in comparison.sections:
        for block in section.blocks:
            for row in block:
                assert all(word in words for cell in row for word in cell.split())
