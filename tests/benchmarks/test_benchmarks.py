"""The benchmarks run, and what they compare is the same thing. Nothing here tests how fast it is."""

from __future__ import annotations

import importlib
import math
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent.parent.parent))  # not part of the package

from mbocp_papers.pendulums.figures import FIGURES
from mbocp_papers.pendulums.tables import TITLES

from benchmarks.growth import growth_rows, table_of
from benchmarks.machine import header
from benchmarks.newton import CASES, Stepper, exponent, in_rounds, iteration_table, load, scaling_table
from benchmarks.paper.__main__ import DOCS, TABLES, replaced
from benchmarks.quality import WAYS, quality_table, record, refined, tasks
from benchmarks.random_tasks import random_problems
from benchmarks.records import Found, Key, Records
from benchmarks.reliability import reliability_table
from benchmarks.rivals import compare, reach
from benchmarks.stages import stage_table, time_stages
from benchmarks.tables import Table, show

PENDULUM = next(case for case in CASES if case.label == "rigid_pendulum")


@pytest.mark.parametrize("name", sorted(path.stem for path in (DOCS.parent / "benchmarks").glob("[!_]*.py")))
def test_every_benchmark_is_imported(name: str) -> None:
    importlib.import_module(f"benchmarks.{name}")


def test_every_case_is_an_example() -> None:
    for case in CASES:
        assert load(case).num_steps >= 100


def test_one_iteration_is_timed_with_its_parts() -> None:
    (t,) = in_rounds([Stepper(load(PENDULUM, "horizon.steps=10"))], [6])
    assert t.num_steps == 10
    assert t.unknowns == 17 * 10 + 4
    assert t.iterations >= 5
    assert all(seconds > 0.0 for seconds in (t.step, t.evaluate, t.factorise, t.solve, t.trial, t.whole))


def test_a_table_has_a_row_for_each_case() -> None:
    made = iteration_table([PENDULUM], repetitions=3)
    assert [row[0] for row in made.rows] == ["rigid_pendulum"]
    assert len(made.rows[0]) == len(made.columns)


def test_exponent_of_a_power() -> None:
    steps = [100, 300, 1000]
    assert exponent(steps, [1e-6 * n**1.25 for n in steps]) == pytest.approx(1.25)


def test_growth_in_time_and_memory_is_that_of_one_horizon_after_the_other() -> None:
    list(growth_rows("elastic_pendulum", (50,), (1,)))  # what compiles takes memory, too
    found = list(growth_rows("elastic_pendulum", (50, 1500), (1, 2)))
    assert [(g.num_steps, g.threads) for g in found] == [(50, 1), (50, 2), (1500, 1), (1500, 2)]
    few, again, many, _ = found
    assert few.whole is not None
    assert many.whole is not None
    assert again.whole is None
    assert few.whole.converged
    assert many.whole.converged
    assert many.whole.iterations <= few.whole.iterations + 1
    assert 25 < many.stages / few.stages < 40
    assert many.whole.peak - few.whole.peak > many.stages - few.stages > 0  # stages are not all that is kept
    assert 0.0 < few.evaluate + few.factorise + few.solve < few.iteration
    rows = table_of("elastic_pendulum", found).rows
    assert [row[:2] for row in rows] == [("50", "1"), ("1500", "1"), ("50", "2"), ("1500", "2")]
    assert rows[1][6] == f"{many.whole.iterations}"
    assert rows[3][6] == ""


def test_growth_is_measured_at_every_number_of_steps() -> None:
    made, fitted = scaling_table(PENDULUM, (10, 20), budget=60)
    assert [row[0] for row in made.rows] == ["10", "20"]
    assert np.isfinite(fitted)


def test_stages_are_timed_compiled_and_as_tapes() -> None:
    found = time_stages(load(PENDULUM), repetitions=5)
    assert found.compiled > 0.0
    assert found.ratio == found.interpreted / found.compiled
    assert len(stage_table([PENDULUM], repetitions=1).rows) == 1


def test_the_rival_finds_the_same_optimum() -> None:
    """IPOPT on an independent transcription of scheme SE1."""
    c = compare(reach(num_steps=8), repetitions=1)
    assert c.difference < 1e-8
    assert c.functions < c.rival


def test_tables_print_in_both_ways(capsys: pytest.CaptureFixture[str]) -> None:
    made = Table("Time [ms]", ("name", "time [ms]"), [("a [b]", "1.0")], "A note.")
    show(made)
    show(made, markdown=True)
    printed = capsys.readouterr().out
    assert printed.count("Time [ms]") == 2
    assert "| a [b] | 1.0 |" in printed


def test_the_header_names_versions() -> None:
    assert any("casadi" in row[1] for row in header().rows)


def test_text_is_put_between_markers() -> None:
    page = "a\n<!-- x: begin -->\nold\n<!-- x: end -->\nb"
    assert replaced(page, "x", "new") == "a\n<!-- x: begin -->\n\nnew\n<!-- x: end -->\nb"
    with pytest.raises(SystemExit, match="markers of 'y' 0 times"):
        replaced(page, "y", "new")


@pytest.mark.parametrize("name", ["machine", *(f"table {number}" for number in TITLES)])
def test_the_documentation_has_a_place_for_every_table(name: str) -> None:
    page = TABLES.read_text(encoding="utf-8")
    assert "new\n" in replaced(page, name, "new\n")


@pytest.mark.parametrize("number", FIGURES)
def test_the_documentation_s_figures_are_small(number: int) -> None:
    picture = DOCS / "images" / f"paper_fig{number}.png"
    assert picture.stat().st_size < 200_000
    assert picture.name in (DOCS / "paper.md").read_text(encoding="utf-8")


def test_random_problems_are_the_same_for_the_same_seed() -> None:
    for name in ("double pendulum", "scales", "paper"):
        first, again = (list(random_problems(name, 3, 5)) for _ in range(2))
        other = list(random_problems(name, 3, 6))
        for a, b in zip(first, again, strict=True):
            assert (a.duration, a.num_steps) == (b.duration, b.num_steps)
            assert np.array_equal(a.q_start, b.q_start)
            assert np.array_equal(a.cost.effort, b.cost.effort)
        assert any(a.num_steps != b.num_steps for a, b in zip(first, other, strict=True))


def test_reliability_counts_what_is_solved() -> None:
    row = {"class": "a", "iterations": 4, "seconds": 0.002}
    statuses = ("converged", "under_resolved", "infeasible", "stagnated", "infeasible")
    table = reliability_table([{**row, "status": status} for status in statuses])
    assert table.rows == [("a", "2 / 5", "4 / 4 / 4", "2 / 2 / 2", "2", "2 infeasible, 1 stagnated")]


def test_quality_compares_with_the_best_of_all(tmp_path: Path) -> None:
    records = Records(tmp_path / "part.jsonl")
    one, both = ["double pendulum"], ["effort"]
    record(records, one, both, list(WAYS), range(2), seed=1, time_limit=30.0)
    again = Records.read(tmp_path / "part.jsonl")
    assert again.found == records.found
    record(again, one, both, list(WAYS), range(2), seed=1, time_limit=0.0)  # solves nothing twice
    made = quality_table(again, one, both)
    assert [row[1] for row in made.rows] == list(WAYS)
    by_way = {row[1]: row for row in made.rows}
    assert all(int(row[2]) + int(row[3]) <= 2 for row in made.rows)
    most = by_way["auto, 4 starts"]  # nothing else has as many guesses
    assert int(most[2]) >= 1
    assert most[5].startswith(f"100 % of {most[2]} (")
    first, second = tasks("double pendulum", "auto", 2, 1)
    changes = refined(first, 30.0)
    assert len(changes) == 3  # the ways with one guess
    assert all(0.0 < turn < 1.0 and abs(change) < 0.1 for turn, change in changes)
    assert not first.is_bounded
    assert first.cost.velocity.any()
    assert not np.array_equal(first.goal.q, second.goal.q)


def test_what_the_steps_do_not_resolve_is_no_measure() -> None:
    good, spun = Found(2.0, 10, 0.1, is_resolved=True), Found(1.0, 10, 0.1, is_resolved=False)
    failed = Found(math.inf, 10, 0.1, is_resolved=False)
    records = Records()
    for way, found in {"auto": good, "auto, 4 starts": good, "ipopt": spun, "fatrop": failed}.items():
        records.add(Key("double pendulum", "effort", 0, 0, way), found)
    records.add(Key("double pendulum", "effort", 0, 1, "auto"), good)  # not all ways: does not count
    made = quality_table(records, ["double pendulum"], ["effort"])
    rows = {row[1]: row for row in made.rows}
    assert rows["auto"][2:4] == ("1", "0")
    assert rows["ipopt"][2:4] == ("0", "1")
    assert rows["fatrop"][2:4] == ("0", "0")
    assert [rows[way][4][:3].strip() for way in ("auto", "ipopt", "fatrop")] == ["100", "0 %", "0 %"]
    assert [rows[way][6][:3].strip() for way in ("auto", "ipopt", "fatrop")] == ["0 %", "100", "0 %"]
