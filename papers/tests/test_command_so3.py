"""`mbocp paper --paper so3`: what it says, what it refuses, rows that are there."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from mbocp_papers.so3.experiment import Lattice

from papers.tests.so3 import rows

from .conftest import Run

SO3 = ("paper", "--paper", "so3")


def test_without_options_it_says_what_there_is(run: Run) -> None:
    done = run(*SO3)
    assert done.exit_code == 0
    assert "--table 3  nodes of the graph" in done.stdout
    assert "--figure 12  accuracy against" in done.stdout
    assert "--figure 8  rate of success *" in done.stdout


def test_a_table(run: Run) -> None:
    done = run(*SO3, "--table", "3")
    assert done.exit_code == 0, done.output
    assert "DCM RK-MK" in done.stdout
    assert "casadi" in done.stdout.splitlines()[0]


def test_figures_from_rows(run: Run, tmp_path: Path) -> None:
    path = rows.random_rows(tmp_path / "rows.jsonl", Lattice(2, 2))
    out = tmp_path / "out"
    done = run(*SO3, "--figure", "8", "--figure", "10", "--results", str(path), "-o", str(out))
    assert done.exit_code == 0, done.output
    assert "The lattice by six formulations" in done.stdout
    assert {p.name for p in out.iterdir()} == {"so3_fig8.png", "so3_fig10.png"}


def test_json_is_alone_on_stdout(run: Run, tmp_path: Path) -> None:
    path = rows.written(tmp_path / "rows.jsonl", Lattice(2, 1))
    arguments = ("--figure", "8", "--table", "3", "--results", str(path), "-o", str(tmp_path), "--json")
    done = run(*SO3, *arguments)
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["lattice"]["formulations"]["Q RK"]["ends"]["upright"] == 4
    assert found["lattice"]["file"] == str(path)
    assert found["tables"]["3"]["Q RK"]["paper"] == [639]
    assert found["figures"]["8"] == [str(tmp_path / "so3_fig8.png")]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--table", "1"), "--table: got 1, expected one of 3, 4"),
        (("--figure", "1"), "figure 1 is a sketch"),
        (("--figure", "13"), "--figure: got 13, expected one of 3, 4, 5"),
        (("--figure", "8", "--lattice", "5x5"), "--lattice: got 5x5, expected places along x"),
        (("--figure", "8", "--lattice", "5x4x3"), "as many places along x as along y"),
        (("--figure", "8", "--variant", "printed"), "--variant: got printed, expected one of corrected"),
        (("--figure", "8", "--solver", "snopt"), "--solver: got snopt, expected one of ipopt, fatrop"),
        (("--figure", "8", "--results", "nowhere/rows.jsonl"), "there is no folder 'nowhere'"),
        (("--figure", "8", "--results", "."), "--results is a folder"),
        (("--figure", "8", "--workers", "0"), "Invalid value for '--workers'"),
    ],
)
def test_bad_input(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    done = run(*SO3, *arguments)
    assert done.exit_code == 2, done.output
    assert message in done.stderr
    assert not done.stdout.strip() or "casadi" in done.stdout


def test_an_unknown_paper(run: Run) -> None:
    done = run("paper", "--paper", "third")
    assert done.exit_code == 2
    assert "--paper: got third, expected one of first, so3" in done.stderr


@pytest.mark.parametrize(
    "arguments", [("--lattice", "5x5x4"), ("--variant", "corrected"), ("--workers", "2"), ("--resume",)]
)
def test_options_of_the_second_paper_alone(run: Run, arguments: tuple[str, ...]) -> None:
    done = run("paper", "--table", "2", *arguments)
    assert done.exit_code == 2
    assert f"{arguments[0]} belongs to the second paper; add --paper so3" in done.stderr


def test_a_file_of_another_study(run: Run, tmp_path: Path) -> None:
    (tmp_path / "rows.jsonl").write_text("{}\n")
    done = run(*SO3, "--figure", "8", "--results", str(tmp_path / "rows.jsonl"), "-o", str(tmp_path))
    assert done.exit_code == 2
    assert "is not the table of a study" in done.stderr


def test_rows_go_on_only_for_the_same_study(run: Run, tmp_path: Path) -> None:
    path = rows.written(tmp_path / "rows.jsonl", Lattice(2, 1), count=2)
    done = run(
        *SO3, "--figure", "8", "--results", str(path), "--resume", "--lattice", "2x2x2", "-o", str(tmp_path)
    )
    assert done.exit_code == 2
    assert "belongs to another study" in done.stderr
