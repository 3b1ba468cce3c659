"""`mbocp paper`: exit status, what goes where, bad input."""

from __future__ import annotations

import json
import shlex
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
import typer
from matplotlib.figure import Figure
from mbocp_papers.cli.command import _EXAMPLES, app
from mbocp_papers.pendulums import figures

from .conftest import Run


def test_without_options_it_says_what_there_is(run: Run) -> None:
    done = run("paper")
    assert done.exit_code == 0
    assert "--table 7  2D elastic pendulum" in done.stdout
    assert "--figure 2  3D elastic pendulum" in done.stdout


def test_a_table(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = run("paper", "--table", "2", "--quick")
    assert done.exit_code == 0, done.output
    assert "FBSM-BB + FBSM-Newton" in done.stdout
    assert "56.29 s" in done.stdout
    assert "casadi" in done.stdout.splitlines()[0]
    assert "Table 2" in done.stderr
    assert not list(tmp_path.iterdir())


def test_json_is_alone_on_stdout(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    empty = figures.FigureSpec("empty", lambda _say: Figure(figsize=(1, 1)))
    monkeypatch.setattr(figures, "FIGURES", {7: empty})
    done = run("paper", "--table", "7", "--figure", "7", "--quick", "--json", "-o", str(tmp_path / "new"))
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["tables"]["7"]["forms"]["tracking"][0]["dof"] == 261
    assert found["figures"]["7"] == [str(tmp_path / "new" / "paper_fig7.png")]
    assert (tmp_path / "new" / "paper_fig7.png").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--table", "8"), "--table: got 8, expected one of 1, 2, 3, 4, 5, 6, 7"),
        (("--table", "1", "--figure", "1"), "figure 1 is a sketch"),
        (("--table", "two"), "Invalid value for '--table'"),
    ],
)
def test_unknown_numbers(run: Run, arguments: tuple[str, ...], message: str) -> None:
    done = run("paper", *arguments)
    assert done.exit_code == 2
    assert message in done.stderr
    assert not done.stdout


def test_a_folder_that_is_a_file(run: Run, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    done = run("paper", "--figure", "7", "-o", str(tmp_path / "taken"))
    assert done.exit_code == 2
    assert "--output is a file" in done.stderr


@pytest.mark.parametrize("line", _EXAMPLES)
def test_examples_are_commands_with_their_options(line: str, run: Run) -> None:
    program, name, *words = shlex.split(line)
    assert program == "mbocp"
    command: Any = typer.main.get_command(app)
    with command.make_context(name, words, resilient_parsing=False) as context:
        assert context.params
    assert line in run(name, "--help").stdout


def test_a_command_that_cannot_be_loaded_is_told(
    monkeypatch: pytest.MonkeyPatch, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = EntryPoint("gone", "no_such_module:app", "mbocp.commands")
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [broken])
    done = run("--help")
    assert done.exit_code == 0
    assert "solve" in done.stdout
    assert (
        "warning: the commands of no_such_module:app cannot be loaded: No module named"
        in capsys.readouterr().err
    )
