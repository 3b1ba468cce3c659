"""`mbocp study`: exit status, what goes where, and bad input."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbocp.study import StudyResult
from tests.solution.test_atomic import full_disk

from .conftest import Run

EXAMPLES = Path(__file__).parents[2] / "examples"

STUDY = """
problem = "pendulum.toml"

[fixed]
"horizon.steps" = 10

[[axis]]
name = "scheme"
values = [
    { label = "SE1", "integrator.scheme" = "se1" },
    { label = "SE2", "integrator.scheme" = "se2" },
]

[grid]
"cost.effort" = [0.5, 1.0]
"""


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    shutil.copy(EXAMPLES / "paper/rigid_pendulum.toml", tmp_path / "pendulum.toml")
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path


def test_the_example_runs(tmp_path: Path, run: Run) -> None:
    rows = tmp_path / "rows.jsonl"
    done = run("study", str(EXAMPLES / "studies/pendulum_goals.toml"), "-o", str(rows), "--json")
    assert done.exit_code == 1  # some end on the other side of the sphere, and have not converged
    facts = json.loads(done.stdout)
    assert (facts["tasks"], facts["done"], facts["by"]) == (45, 45, ["scheme"])
    assert [group["values"] for group in facts["groups"]] == [["SE1"], ["SE2"], ["midpoint"]]
    result = StudyResult.load(rows)
    assert set(result.column("status")) == {"converged", "other_root"}
    assert result.column("q_final").shape == (45, 3)
    # The projected end condition holds on the other side of the sphere, too.
    off = result.column("goal_distance") > 1e-6
    np.testing.assert_array_equal(off, result.column("status") == "other_root")
    assert facts["not_converged"] == {"other_root": off.sum()}
    assert off.sum() < 15


def test_rows_summary_and_pictures(study: Path, run: Run) -> None:
    done = run("study", "study.toml", "-o", "rows.jsonl", "--plot", "bars.png", "--csv", "rows.csv")
    assert done.exit_code == 0, done.stderr
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert lines[0].split() == ["study", "4", "tasks"]
    assert lines[1].split()[:4] == ["scheme", "cost.effort", "tasks", "success"]
    assert lines[2].split()[:5] == ["SE1", "0.5", "1", "100.0", "%"]
    rows = StudyResult.load("rows.jsonl")
    least = int(rows.column("cost").argmin())
    assert f"best  task {least}, cost {rows.column('cost')[least]:.6g}: " in done.stdout
    for name in ("rows.jsonl", "bars.png", "rows.csv"):
        assert name in done.stdout
        assert (study / name).stat().st_size > 300

    again = run("study", "--summary", "rows.jsonl", "--by", "scheme")
    assert again.exit_code == 0
    lines = again.stdout.splitlines()
    assert lines[2].split()[:4] == ["SE1", "2", "100.0", "%"]
    assert "±" in lines[2]
    (study / "bars.png").unlink()
    quiet = run("study", "--summary", "rows.jsonl", "--plot", "bars.png", "-q")
    assert (quiet.stdout, quiet.stderr) == ("", "")
    assert (study / "bars.png").exists()


def test_rows_that_did_not_converge_are_1(study: Path, run: Run) -> None:
    """Six steps turn the pendulum too far in each; one iteration is too few."""
    (study / "pendulum.toml").write_text(
        'robot = "double_pendulum"\nhorizon = { duration = 2, steps = 6 }\ngoal = { q = [2, 0.5], v = 0 }\n'
        "cost = { effort = 1 }\n"
    )
    iterations = "[grid]\n'solver.max_iterations' = [1, 100]\n"
    (study / "study.toml").write_text('problem = "pendulum.toml"\n' + iterations)
    done = run("study", "study.toml", "-o", "rows.jsonl")
    assert done.exit_code == 1, done.stderr
    ends = StudyResult.load(study / "rows.jsonl").not_converged
    assert ends == {"max_iterations": 1, "under_resolved": 1}
    assert "2 of 2 tasks did not converge: max_iterations 1, under_resolved 1" in done.stdout
    assert run("study", "study.toml", "-o", "rows.jsonl", "--resume", "-q").exit_code == 1
    summed = run("study", "--summary", "rows.jsonl", "--json")
    assert summed.exit_code == 0
    assert json.loads(summed.stdout)["not_converged"] == ends


def test_a_full_disk_is_2(study: Path, run: Run) -> None:
    with full_disk(800):
        failed = run("study", "study.toml", "-o", "rows.jsonl", "--workers", "1")
    assert failed.exit_code == 2
    assert failed.stderr.count("error: ") == 1
    assert "rows.jsonl: cannot be written: File too large" in " ".join(failed.stderr.split())
    done = run("study", "study.toml", "-o", "rows.jsonl", "--resume", "-q")
    assert done.exit_code == 0, done.stderr
    for option, name in (("--csv", "rows.csv"), ("--plot", "bars.png")):
        (study / name).write_text("old")
        with full_disk(500):
            failed = run("study", "--summary", "rows.jsonl", option, name)
        assert (failed.exit_code, failed.stdout) == (2, "")
        assert failed.stderr.count("error: ") == 1
        assert f"{name}: cannot be written: File too large" in " ".join(failed.stderr.split())
        assert (study / name).read_text() == "old"


def test_a_file_that_is_not_finished(study: Path, run: Run) -> None:
    assert run("study", "study.toml", "-o", "rows.jsonl", "-q").exit_code == 0
    lines = (study / "rows.jsonl").read_text().splitlines(keepends=True)
    (study / "rows.jsonl").write_text("".join(lines[:3]) + lines[3][:50])
    assert "2 of 4 tasks" in run("study", "--summary", "rows.jsonl").stdout
    resumed = run("study", "study.toml", "-o", "rows.jsonl", "--resume", "--json")
    assert json.loads(resumed.stdout)["done"] == 4
    assert (study / "rows.jsonl").read_text().startswith("".join(lines[:3]))


def test_dask_by_its_option(study: Path, run: Run) -> None:
    pytest.importorskip("distributed", reason="Dask's `distributed` is not installed")
    done = run("study", "study.toml", "-o", "rows.jsonl", "--scheduler", "local", "--workers", "1", "--json")
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["done"] == 4


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ([], "give a study file to run or --summary FILE.jsonl to sum up, one of the two"),
        (["study.toml", "--summary", "rows.jsonl"], "one of the two"),
        (["study.toml"], "say with -o FILE.jsonl where the rows go"),
        (["study.toml", "-o", "rows.txt"], "rows.txt: -o must end in .jsonl or .ndjson, got .txt"),
        (["study.toml", "-o", "nowhere/rows.jsonl"], "there is no folder 'nowhere'"),
        (["study.toml", "-o", "rows.jsonl", "--plot", "bars.gif"], "--plot must end in .png"),
        (["study.toml", "-o", "rows.jsonl", "--csv", "rows.txt"], "--csv must end in .csv"),
        (["missing.toml", "-o", "rows.jsonl"], "missing.toml: no such file"),
        (["pendulum.toml", "-o", "rows.jsonl"], "pendulum.toml: is a problem, expected a study"),
        (
            ["study.toml", "-o", "rows.jsonl", "--by", "cost"],
            "--by cost: is not varied; varied are cost.effort",
        ),
        (["study.toml", "-o", "old.jsonl"], "old.jsonl: exists already; go on with it (--resume"),
        (["study.toml", "-o", "old.jsonl", "--resume"], "old.jsonl: is not the table of a study"),
        (["study.toml", "-o", "rows.jsonl", "--resume", "--overwrite"], "give one of the two"),
        (["--summary", "old.jsonl"], "old.jsonl: is not the table of a study"),
        (["--summary", "missing.jsonl"], "missing.jsonl: no such file"),
    ],
)
def test_bad_input_is_2(study: Path, run: Run, arguments: list[str], reason: str) -> None:
    (study / "old.jsonl").write_text("something old\n")
    done: Any = run("study", *arguments)
    assert done.exit_code == 2
    assert done.stderr.startswith("error: ")
    assert reason in done.stderr
    assert not (study / "rows.jsonl").exists()
    assert (study / "old.jsonl").read_text() == "something old\n"
