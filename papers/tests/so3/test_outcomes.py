"""Rows are classified by the final attitude, and summed up."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mbocp_papers.so3.experiment import Lattice
from mbocp_papers.so3.outcomes import (
    ELSEWHERE,
    HALF_TURN,
    NOT_CONVERGED,
    UPRIGHT,
    Outcomes,
    outcomes_of,
    running_mean,
    settled_after,
    turn_from_upright,
)
from mbocp_papers.so3.tables import summary_table

from mbocp.exceptions import StudyError
from mbocp.study import Study, StudyResult, run_study

from . import rows

SMALL = Lattice(2, 1)


def outcomes(path: Path, make: rows.Row = rows.row, **options: Any) -> Outcomes:
    return outcomes_of(rows.loaded(rows.written(path / "rows.jsonl", SMALL, make, **options)))


def turned(angle: float, axis: tuple[float, float, float]) -> list[float]:
    return [0.3, -0.2, *(math.sin(angle / 2) * np.array(axis)), math.cos(angle / 2), 1.0]


@pytest.mark.parametrize("angle", [0.0, 1e-7, 0.5, 3.0, math.pi])
def test_turn_from_upright_is_the_angle(angle: float) -> None:
    q = turned(angle, (0.6, 0.0, -0.8))
    assert math.isclose(turn_from_upright(q), angle, rel_tol=1e-12, abs_tol=1e-15)
    opposite = [*q[:2], *(-x for x in q[2:6]), q[6]]
    assert math.isclose(turn_from_upright(opposite), angle, rel_tol=1e-12, abs_tol=1e-15)


@pytest.mark.parametrize(
    ("q", "converged", "end"),
    [
        (rows.UPRIGHT, True, UPRIGHT),
        (turned(0.9e-6, (0, 1, 0)), True, UPRIGHT),
        (turned(2e-6, (0, 1, 0)), True, ELSEWHERE),
        (rows.HANGING, True, HALF_TURN),
        (turned(math.pi - 1e-5, (0, 0.6, 0.8)), True, HALF_TURN),
        (turned(1.0, (1, 0, 0)), True, ELSEWHERE),
        (rows.UPRIGHT, False, NOT_CONVERGED),
        (None, False, NOT_CONVERGED),
    ],
)
def test_ends(q: list[float] | None, converged: bool, end: str, tmp_path: Path) -> None:
    def make(index: int, label: str) -> dict[str, Any]:
        record = {} if q is None else {"record": {"q_final": q}}
        return {**rows.row(index, label), "converged": converged, "record": {}, **record}

    assert set(outcomes(tmp_path, make).runs[0].ends) == {end}


def test_means_are_over_the_successes(tmp_path: Path) -> None:
    def make(index: int, label: str) -> dict[str, Any]:
        made = rows.row(index, label) | {"iterations": 10 * (index + 1), "solver_time_s": 0.1}
        if label == "Q RK" and index == 3:
            made |= {"status": "max_iterations", "converged": False, "iterations": 1000}
        if label == "DCM RK" and index == 0:
            made["record"] = {"q_final": rows.HANGING}
        return made

    found = outcomes(tmp_path, make)
    by_label = {runs.label: runs for runs in found.runs}
    assert by_label["Q RK"].spread("iterations").mean == 20.0
    assert by_label["Q RK"].failures == {"max_iterations": 1}
    assert by_label["Q RK"].success_rate == 0.75
    assert by_label["DCM RK"].spread("iterations").mean == 30.0
    assert by_label["DCM RK"].counts == {UPRIGHT: 3, HALF_TURN: 1, ELSEWHERE: 0, NOT_CONVERGED: 0}
    assert found.common.tolist() == [1, 2]
    assert by_label["Q RK"].spread("iterations", found.common).mean == 25.0
    assert math.isclose(by_label["Q RK-MK"].spread("milliseconds").mean, np.mean([10, 5, 10 / 3, 2.5]))


def test_no_success_is_no_number(tmp_path: Path) -> None:
    def make(index: int, label: str) -> dict[str, Any]:
        return {**rows.row(index, label), "converged": False, "iterations": None, "cost": None}

    found = outcomes(tmp_path, make)
    assert math.isnan(found.runs[0].spread("cost").mean)
    assert not found.common.size
    assert "-" in summary_table(found).markdown()


def test_an_unfinished_file_says_so(tmp_path: Path) -> None:
    found = outcomes(tmp_path, count=7)
    assert not found.is_complete
    assert found.words == "7 of 24 tasks, monolithic, corrected"
    assert [len(runs.ends) for runs in found.runs] == [2, 1, 1, 1, 1, 1]


def test_solver_and_variant_are_read(tmp_path: Path) -> None:
    found = outcomes(tmp_path, variant="as_printed", solver="ipopt")
    assert (found.solver, found.variant) == ("ipopt", "as_printed")
    assert "as printed" in found.words


def test_the_running_mean_ends_at_the_mean(tmp_path: Path) -> None:
    found = outcomes_of(rows.loaded(rows.random_rows(tmp_path / "rows.jsonl", Lattice(4, 4))))
    for runs in found.runs:
        means = running_mean(runs, "iterations")
        assert len(means) == runs.counts[UPRIGHT]
        assert math.isclose(means[-1], runs.spread("iterations").mean)
        assert np.array_equal(means, running_mean(runs, "iterations"))
        settled = settled_after(means)
        assert (np.abs(means[settled - 1 :] - means[-1]) <= 0.04 * means[-1]).all()
        assert settled == 1 or abs(means[settled - 2] - means[-1]) > 0.04 * means[-1]


def test_settling_of_few_numbers() -> None:
    assert settled_after(np.zeros(0)) == 0
    assert settled_after(np.array([5.0])) == 1
    assert settled_after(np.array([9.0, 5.0, 5.1])) == 2


def test_the_summary_has_all_formulations(tmp_path: Path) -> None:
    table = summary_table(outcomes(tmp_path))
    text = table.markdown()
    for label in ("Q RK", "Q RK+BG", "Q RK-MK", "DCM RK", "DCM RK+BG", "DCM RK-MK"):
        assert f"| {label} | 4 | 100.0 % | 0 | 0 | 50.0 ± 0.0 | 5.00 ± 0.00 |" in text
        assert table.data["formulations"][label]["ends"][UPRIGHT] == 4
    assert table.data["common_tasks"] == 4
    assert table.number is None


def test_rows_of_other_studies_are_refused(tmp_path: Path) -> None:
    tables = {"problem": str(Path("examples/paper/rigid_pendulum.toml").absolute())}
    study = Study.from_tables({**tables, "fixed": {"horizon.steps": 4}, "grid": {"cost.effort": [0.5]}})
    result = run_study(study, tmp_path / "other.jsonl", workers=1)
    with pytest.raises(StudyError, match=r"no study of the second paper's lattice: it varies cost\.effort"):
        outcomes_of(result)


def test_a_file_without_rows_is_refused(tmp_path: Path) -> None:
    path = rows.written(tmp_path / "rows.jsonl", SMALL, count=0)
    with pytest.raises(StudyError, match="no rows yet"):
        outcomes_of(StudyResult.load(path))
