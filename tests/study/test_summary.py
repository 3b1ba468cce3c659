"""What is made of the rows: columns, groups, tables for other programs, pictures."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbocp.exceptions import ResultFileError, StudyError
from mbocp.study import StudyResult
from mbocp.study.run_task import failure_row
from mbocp.study.summary import Spread

HEADER: dict[str, Any] = {
    "format": "mbocp study",
    "format_version": 1,
    "mbocp": "1",
    "name": "made up",
    "digest": "a" * 64,
    "tasks": 9,
    "varied": ["how", "horizon.steps", "goal.q"],
    "by": ["how"],
    "goal_distance": None,
    "record": ["q_final", "us", "guess_used", "parameters"],
    "tables": {},
}


def row(index: int, how: str, steps: int, **fields: Any) -> dict[str, Any]:
    good = {
        "status": "converged",
        "converged": True,
        "iterations": 10 + index,
        "solver_time_s": 0.1 * (10 + index),
        "total_time_s": 3.0,
        "cost": float(index),
        "residual": 1e-12,
        "constraint_violation": 0.0,
        "manifold_drift": None,
        "limit_violation": 0.0,
        "goal_distance": 1e-9 * index,
        "message": "",
        "record": {
            "q_final": [1.0, float(index)],
            "us": [[1.0, 2.0]],
            "guess_used": "a line",
            "parameters": {"a": float(index)},
        },
    }
    values = {"how": how, "horizon.steps": steps, "goal.q": [0.0, 1.0]}
    return {"index": index, "values": values, **good, **fields}


@pytest.fixture
def result() -> StudyResult:
    rows = [
        row(0, "slow", 5),
        row(1, "fast", 5),
        row(2, "slow", 10),
        row(3, "fast", 10, status="stagnated", converged=False, message="no way"),
        row(4, "slow", 5, goal_distance=2.0),
        {**row(5, "fast", 5), **failure_row("timeout", "killed"), "record": {}},
        row(7, "slow", 10),
    ]
    return StudyResult(HEADER, tuple(rows))


def test_columns_are_arrays(result: StudyResult) -> None:
    assert (len(result), result.num_tasks, result.is_complete, result.missing) == (7, 9, False, (6, 8))
    np.testing.assert_array_equal(result.column("index"), [0, 1, 2, 3, 4, 5, 7])
    assert result.column("index").dtype == np.int64
    assert result.column("converged").dtype == np.bool_
    assert result.column("how").tolist() == ["slow", "fast"] * 3 + ["slow"]
    np.testing.assert_array_equal(result.column("cost"), [0, 1, 2, 3, 4, math.nan, 7])
    np.testing.assert_array_equal(result.column("manifold_drift"), [math.nan] * 7)
    assert result.column("q_final").shape == (7, 2)
    assert np.isnan(result.column("q_final")[5]).all()
    assert result.column("us").shape == (7, 1, 2)
    assert result.column("guess_used")[5] == ""
    assert result.column("goal.q").shape == (7, 2)
    for name in result.columns:
        assert len(result.column(name)) == 7
    with pytest.raises(StudyError, match="there is no column 'costs': did you mean 'cost'"):
        result.column("costs")


def test_lists_of_several_lengths_and_tables_stay_objects() -> None:
    mixed = [row(0, "a", 1), row(1, "a", 1)]
    mixed[0]["values"]["goal.q"] = {"elbow": 1.0}
    mixed[1]["values"]["how"] = 3
    mixed[1]["record"]["q_final"] = [1.0]
    result = StudyResult(HEADER, tuple(mixed))
    assert result.column("goal.q").tolist() == [{"elbow": 1.0}, [0.0, 1.0]]
    assert result.column("how").tolist() == ["a", 3]
    assert result.column("q_final").tolist() == [[1.0, 0.0], [1.0]]


def test_groups_are_summed_up_over_their_successes(result: StudyResult) -> None:
    summary = result.summary()
    slow, fast = summary.groups
    assert summary.by == ("how",)
    assert (slow.values, slow.tasks, slow.successes, slow.others) == (("slow",), 4, 4, {})
    assert (fast.values, fast.tasks, fast.successes) == (("fast",), 3, 1)
    assert fast.others == {"stagnated": 1, "timeout": 1}
    iterations = [10, 12, 14, 17]
    assert slow.iterations.mean == pytest.approx(np.mean(iterations))
    assert slow.iterations.deviation == pytest.approx(np.std(iterations, ddof=1))
    assert slow.seconds.mean == pytest.approx(0.1 * np.mean(iterations))
    assert slow.seconds_per_iteration.mean == pytest.approx(0.1)
    assert slow.cost.mean == pytest.approx(np.mean([0, 2, 4, 7]))
    assert fast.success_rate == pytest.approx(1 / 3)
    assert fast.cost.mean == 1.0
    assert (slow.best, fast.best) == (0, 1)
    assert math.isnan(fast.cost.deviation)
    json.dumps(summary.to_dict(), allow_nan=False)


def test_a_success_may_have_to_reach_the_goal(result: StudyResult) -> None:
    slow, _ = result.summary(goal_distance=1e-3).groups
    assert (slow.successes, slow.others) == (3, {"off the goal": 1})
    asked = StudyResult({**HEADER, "goal_distance": 1e-3}, result.rows)
    assert asked.summary().groups == result.summary(goal_distance=1e-3).groups


def test_groups_by_several_names_are_in_their_order(result: StudyResult) -> None:
    groups = result.summary(["how", "horizon.steps"]).groups
    assert [group.values for group in groups] == [("slow", 5), ("slow", 10), ("fast", 5), ("fast", 10)]
    assert groups[3].successes == 0
    assert math.isnan(groups[3].cost.mean)
    (all_of_them,) = result.summary([]).groups
    assert (all_of_them.tasks, all_of_them.label) == (7, "all tasks")
    with pytest.raises(StudyError, match="'howe' was not varied: did you mean 'how'"):
        result.summary(["howe"])


def test_csv(result: StudyResult, tmp_path: Path) -> None:
    written = result.to_csv(tmp_path / "rows.csv")
    assert b"\r" not in written.read_bytes()
    with written.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(r["index"]) for r in rows] == [0, 1, 2, 3, 4, 5, 7]
    assert [r["q_final[1]"] for r in rows] == ["0.0", "1.0", "2.0", "3.0", "4.0", "", "7.0"]
    assert [r["parameters[a]"] for r in rows] == ["0.0", "1.0", "2.0", "3.0", "4.0", "", "7.0"]
    assert json.loads(rows[0]["us"]) == [[1.0, 2.0]]
    assert rows[5]["cost"] == ""
    assert rows[3]["message"] == "no way"
    with pytest.raises(ResultFileError, match="does not exist"):
        result.to_csv(tmp_path / "nowhere" / "rows.csv")


@pytest.mark.parametrize("by", [None, [], ["how", "horizon.steps"]])
def test_plots(result: StudyResult, tmp_path: Path, by: list[str] | None) -> None:
    path = result.plot(tmp_path / "bars.png", by)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 10_000


def test_plots_that_cannot_be(result: StudyResult, tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="there are no rows yet"):
        StudyResult(HEADER, ()).plot(tmp_path / "bars.png")
    many = StudyResult({**HEADER, "tasks": 200}, tuple(row(i, f"way {i}", 5) for i in range(101)))
    with pytest.raises(StudyError, match="101 groups are too many for a picture"):
        many.plot(tmp_path / "bars.png")
    with pytest.raises(ResultFileError, match=r"\.gif"):
        result.plot(tmp_path / "bars.gif")


def test_numbers_whose_squares_overflow_have_an_infinite_deviation() -> None:
    assert Spread.of([1e300, -1e300, 0.0]) == Spread(0.0, math.inf)
