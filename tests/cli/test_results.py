"""`mbocp replay`, `plot` and `info`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import mbocp.view.replay

from .conftest import Run


def test_info(result: Path, run: Run) -> None:
    done = run("info", str(result))
    assert done.exit_code == 0
    for words in ("arm", "ur5", "converged: all is well", "12.5", "mbocp 0.1.0"):
        assert words in done.stdout


def test_info_json_is_that_of_solve(result: Path, run: Run) -> None:
    facts = json.loads(run("info", str(result), "--json").stdout)
    assert (facts["status"], facts["cost"]) == ("converged", 12.5)


def test_replay_beside_the_result(result: Path, run: Run) -> None:
    done = run("replay", str(result))
    assert done.exit_code == 0
    page = result.with_suffix(".html")
    assert str(page) in done.stdout
    assert "<html" in page.read_text(encoding="utf-8")[:500].lower()


def test_replay_live(result: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    monkeypatch.setattr(mbocp.view.replay, "open_replay", lambda *a, **k: calls.append(k))
    done = run("replay", str(result), "--open", "--trace", "tool0", "--speed", "0.5")
    assert done.exit_code == 0
    assert calls == [{"trace": ["tool0"], "title": "arm", "speed": 0.5}]
    assert not result.with_suffix(".html").exists()


def test_plot(result: Path, run: Run) -> None:
    done = run("plot", str(result), "-o", "arm.svg")
    assert done.exit_code == 0
    assert Path("arm.svg").stat().st_size > 1000


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["info", "missing.h5"], "missing.h5: no such file"),
        (["info", "arm.toml"], "arm.toml: is not a result file"),
        (["replay", "arm.h5", "--trace", "tool"], "no frame 'tool'"),
        (["replay", "arm.h5", "--speed", "0"], "--speed: got 0"),
        (["replay", "arm.h5", "-o", "nowhere/a.html"], "there is no folder 'nowhere'"),
        (["plot", "arm.h5", "-o", "a.bmp"], "-o must end in .png or .pdf or .svg"),
        (["plot", "missing.h5"], "missing.h5: no such file"),
    ],
)
def test_bad_input_is_2(result: Path, run: Run, arguments: list[str], reason: str) -> None:
    done = run(*arguments)
    assert done.exit_code == 2
    assert reason in done.stderr
    assert done.stdout == ""
