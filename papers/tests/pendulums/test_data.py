"""The paper's printed numbers hold together, and its problems are found."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from mbocp_papers.pendulums.cases import SYSTEMS, paper_problem, problem_file, strategy_settings
from mbocp_papers.pendulums.data import COMPARISONS, CONVERGENCES, STRATEGIES

import mbocp
from mbocp.exceptions import ProblemFileError
from mbocp.problem import load_problem

EXAMPLES = Path(__file__).parents[3] / "examples" / "paper"
# The paper's DOF column: per step, and at once (u_N; with gamma = 1 also mu_N and eta).
DOF = {2: (15, 15), 4: (17, 3), 6: (15, 1), 7: (13, 1)}


def test_seven_tables() -> None:
    assert sorted(t.number for t in (*COMPARISONS, *CONVERGENCES)) == [1, 2, 3, 4, 5, 6, 7]


@pytest.mark.parametrize("table", COMPARISONS, ids=lambda t: f"table {t.number}")
def test_rows_fit_their_step_size(table) -> None:
    duration = paper_problem(table.system, SYSTEMS[table.system].forms[0]).duration
    for row in table.rows:
        assert row.steps * row.dt == pytest.approx(duration)
        each, once = DOF[table.number]
        assert row.dof == each * row.steps + once
        assert len(row.printed) == len(STRATEGIES)
        for strategy, printed in row.measured_strategies():
            assert len(printed.iterations) == (2 if strategy.is_hybrid else 1)
            assert printed.seconds > 0.0


@pytest.mark.parametrize("table", COMPARISONS, ids=lambda t: f"table {t.number}")
def test_unknowns_differ_from_the_dof_column_by_what_is_known(table) -> None:
    """u_N counts in the paper, and mu_N where gamma = 1: mbocp does not solve for them."""
    from mbocp.formulation import transcribe

    problem = paper_problem(table.system, SYSTEMS[table.system].forms[0], table.rows[0].steps)
    extra = problem.robot.nu + (2 * problem.robot.nv if problem.goal.is_exact else 0)
    assert table.rows[0].dof - transcribe(problem).num_unknowns == extra


@pytest.mark.parametrize("table", CONVERGENCES, ids=lambda t: f"table {t.number}")
def test_norms_end_below_the_tolerance(table) -> None:
    for name in ("monolithic", "fbsm_newton"):
        printed = [getattr(row, name) for row in table.printed if getattr(row, name)]
        assert all(math.isfinite(value) for pair in printed for value in pair)
        assert max(printed[-1]) < 1e-9


@pytest.mark.parametrize("name", SYSTEMS)
def test_problem_files_are_the_examples(name: str) -> None:
    assert problem_file(name) == EXAMPLES / f"{name}.toml"
    problem = paper_problem(name, SYSTEMS[name].forms[-1])
    assert problem.dt == pytest.approx(0.01)
    assert np.array_equal(problem.q_start, load_problem(EXAMPLES / f"{name}.toml").q_start)


def test_an_installed_package_carries_the_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    carried = tmp_path / "mbocp" / "data" / "paper"
    carried.mkdir(parents=True)
    monkeypatch.setattr(mbocp, "__file__", str(tmp_path / "mbocp" / "__init__.py"))
    with pytest.raises(ProblemFileError, match="install mbocp again"):
        problem_file("rigid_pendulum")
    (carried / "rigid_pendulum.toml").write_text("")
    assert problem_file("rigid_pendulum") == carried / "rigid_pendulum.toml"


def test_penalty_form() -> None:
    problem = paper_problem("rigid_pendulum", "penalty", 4)
    assert (problem.goal.enforce, problem.cost.terminal) == ("penalty", 1.0)
    assert problem.cost.effort == pytest.approx(1e-3)


def test_hybrids_switch_after_a_fixed_number_of_gradient_steps() -> None:
    settings = strategy_settings(STRATEGIES[2], "none", 500)
    assert settings["solver.method"] == "fbsm_bb+monolithic"
    assert settings["solver.switch_iterations"] == 500
    assert settings["solver.switch_residual"] == settings["solver.switch_cost"] == 0.0
    assert not any("switch" in key for key in strategy_settings(STRATEGIES[0]))
